"""What is found in the sensors' own data: echoes in waveforms, panels and frustum targets in cloud and image.

Nothing here computes an indicator; the modules of the clauses do.
"""
