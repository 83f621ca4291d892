"""Compiled kernels of the waveform decomposition: quiet level, fit of a sum of Gaussians, search for the echoes.

One packet never sees another, so any split over threads gives the same bytes. Positions and widths are in samples here, and a
width is the standard deviation sigma; `observe.waveforms` converts, and holds the statistics that join packets.
"""
