"""Other published methods in the form of the slots: worked examples to copy from, and what the evaluator's own are compared with.

No part of an evaluation uses them unless somebody names them.
"""

BUILT_IN: dict[str, dict[str, str]] = {
    "default": {},
    "waveform-peak": {"echo_decomposition": "evaluator.other_methods.waveforms:peaks"},
    "waveform-richardson-lucy": {"echo_decomposition": "evaluator.other_methods.waveforms:richardson_lucy"},
    "vertex-orthogonal": {"vertex_estimation": "evaluator.other_methods.vertices:orthogonal_planes"},
}
