"""Compiled kernels that take a block of pulses from beams to rows. Plain arrays in and out; no files, no threads.

tree       boxes over the scene's triangles
fan        which triangles each beam's cone touches
surface    what it sees of one smooth surface, or of two that meet in an edge
cone       what it sees of anything else, as a few echoes
caster     the four together, for a scene and a LiDAR
sampling   echoes to samples, noise, whole steps
detection  samples to echoes
rows       detected echoes to rows, and their truth

Each kernel stands in one file with all that it calls: Numba's cache notices changes of that file alone.
"""
