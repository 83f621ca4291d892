"""Mounting errors of a camera from 2x2 boards, by the patent's method: `mounting_by_boards` first, the others serve it."""
