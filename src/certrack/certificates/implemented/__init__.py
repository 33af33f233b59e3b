"""The certificate of the loop as it runs: sampled, delayed, held, quantised, speeds by differences.

For a linear error loop (a law of known parameters, a linear drift) one period is a matrix, and what
acts on it is bounded: the uncertain terms, the sensors, the converter, the reference. The largest
error that they can cause together is a sum of peak gains, and where the uncertain terms grow with
the state, a fixed point of them. Nothing is searched and no solver is used.

:mod:`drive` states the loop as data, from a system; :mod:`period` makes one period of it in balls;
:mod:`outputs` the rows by which an output between two samples is seen; :mod:`gains` what the inputs
of all past periods add to a row; :mod:`fixed_point` the bounds v with v > F(v); :mod:`proof` what
is saved and checked, which :mod:`document` writes; :mod:`certify` the certificate of a system;
:mod:`premises` what it rests on. :mod:`estimate` is the bound in floats, :mod:`margins` the slowest
and the fastest period with a proof. :mod:`enclosed` are floats with bounds of their errors.

More than that plain loop: :mod:`controller_matrices` takes any linear controller from its formulas,
with an observer too; :mod:`levels` cancels a part of the reference's derivatives; :mod:`timing` has
the jitter. Constants with a range are :mod:`channels`, :mod:`ranged` the loop that has them, and
:mod:`cover` the cells of their ranges. Bounds of w that grow faster than the state are evaluated by
:mod:`growing` and claimed from a box of starts by :mod:`regional`; :mod:`region` looks at the truth
only where the states are.

From a start on: :mod:`lags` has the gains of each past period, :mod:`start` the bounds of one
period after the other and of all that come later, :mod:`start_proof` what is saved of them and
checked, :mod:`input_limits` what they are compared with, :mod:`polytope` the starts from which no
limit is met, and :mod:`from_starts` what of all that is in a certificate.
"""
