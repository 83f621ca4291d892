"""What serves the tests on the ground: sphere (8.2), ranging line (9.1), chessboard (9.2).

Their formulas are `evaluator.c8_2…`, `c9_1…` and `c9_2…`; `order` runs them one after the other.
"""
