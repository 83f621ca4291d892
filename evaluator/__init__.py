"""One evaluator for flown and simulated campaigns: GB/T 41450-2022, clauses 5 to 10.

It reads a campaign folder and nothing else; it never sees the scene, the simulator or (outside `score`) the truth.
"""
