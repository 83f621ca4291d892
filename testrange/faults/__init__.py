"""The fault matrix: faults injected one at a time, and where each shows. `study` is what is asked for, `cases` what runs in a
worker, `matrix` the whole with its verdicts, `picture` its drawing."""
