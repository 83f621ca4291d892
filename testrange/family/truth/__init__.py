"""Reference values of the eight indicators from what the simulation knows, and their spread by noise. The standard's formulas are
written anew here; nothing of the evaluator is imported.

sphere: RSD, s(x) · ranging: m_z, K2, R2 · reflectance: m_f, r_f, M_f · geometry: M_z, P_m
"""
