"""Points of a study are run here.

Modules
-------
point      one task simulated, evaluated and reduced to its responses; runs in a worker
responses  what a response's name means
schedule   the order of tasks, retries, what a lost worker means; the same for every place
workers    processes of this machine
cluster    Dask (extra `cluster`)
callables  a response of the user's own
versions   of what a result depends on
store      points/ID.json: what is finished is never repeated
"""
