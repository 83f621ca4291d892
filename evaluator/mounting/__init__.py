"""Camera and LiDAR against the body and each other (9.3.2): observations to one adjustment, blunders, closure, diagnosis.

`geometry` is the order of events; the indicator P_m itself is `evaluator.c9_3_calibration`.
"""
