"""The iterated quadratic bootstrap: the adaptive law analysed on the set that it has reached.

An earlier proof says which box of the errors is reached in the long run. On a box the regressor and
ubar stay between bounds, so at these bounds the loop is linear, and any quadratic function may
serve, not only one that the update laws cancel. Its bounds make a smaller box, and so on.

`loop` is the adaptive loop as numbers, `box` what a stage stands on, `ranges` what its formulas are
on the box, `forms` the loop at the corners of these ranges, `inequality` the conditions, linear in
the unknowns, `program` their best solution in floats, `proof` the exact one, `search` the
iteration, `check` the proof of all stages from the text of the system, `document` their records.
"""
