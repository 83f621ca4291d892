"""Reference pairs: inputs and results of every numbered formula to 30 digits, to test any evaluator without images.

In the way of NPL's reference data sets and PTB's TraCIM. `clauses/` computes them with mpmath from the standard's text alone and
shares no mathematics with the evaluator; `model` is the form of a pair, `write` the files, `verify` the judge, `ours` this
project's evaluator as one candidate.
"""
