"""The indoor benches: integrating sphere (8.2.2) and chessboard (9.2.2), taken with the flight's own camera."""
