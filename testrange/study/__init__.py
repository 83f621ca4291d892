"""Studies: what the indicators do when flight, sensors, light or errors are varied.

Modules
-------
model      the study file (TOML)
design     factors to rows: grid, list, Latin hypercube, Sobol, Morris
plan       rows to points: configuration, identity, geometry group, shard
run        all of it in order; execution/: where and how points are run, and what a response is
table      table.parquet
effects    main effects, Sobol and Morris indices, grades
report/    figures, study.html, what the command prints
ishigami   a response with known indices, for trying
"""
