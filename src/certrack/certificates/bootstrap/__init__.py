"""The iterated bootstrap: the adaptive law analysed on the set that it has reached.

An earlier proof says which box of the errors is reached in the long run. On a box the regressor and
ubar stay between bounds, so at these bounds the loop is linear, and any quadratic function may
serve, not only one that the update laws cancel. Its bounds make a smaller box, and so on.

`loop` is the adaptive loop as numbers, `box` what a stage stands on, `ranges` what its formulas are
on the box, `forms` the loop at the corners of these ranges, `inequality` the conditions, linear in
the unknowns, `program` their best solution in floats, `proof` the exact one, `search` the
iteration, `check` the proof of all stages from the text of the system, `document` their records.

With more effort polynomials of higher degree follow. What a quadratic function is asked to fulfil,
`conditions` asks of a polynomial of the errors, and of y_d ... y_d^(q) if `variables` puts them
among the variables: polynomials that must not be negative. Each is a sum of squares, shown by a
positive definite Gram matrix (`gram`). `monomials` is their arithmetic, for floats and rationals;
`polynomial_program`, `polynomial_proof` and `polynomial_stages` are to polynomials what `program`,
`proof` and `search` are to quadratic functions.
"""
