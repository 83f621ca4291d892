"""Conformance data sets whose true indicators are set on purpose.

Modules
-------
model       a family's file, its members, what is expected of an evaluator
design      which members there are: grades, boundaries, violated clauses
violations  one clause of conformity violated at a time; edits: of records, where no setting does it
knobs       from the true value wanted to the faults that set it, by root finding
truth/      reference values from what the simulation knows, by the standard's formulas written anew; nothing of the evaluator is
            imported there
make        campaign folders, expected files and cards; resumes
cards       what a member says of itself
evaluate    this project's evaluator over the members
verify      somebody's results against what is expected; mistakes: their names where they can be told
"""
