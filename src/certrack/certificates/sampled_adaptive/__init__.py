"""The bootstrap of the adaptive law as a drive runs it: sampled, held, delayed, with finite steps.

Between samples let theta_hat(t), delta_hat(t) be what the steps of the estimates interpolate:
straight lines for Euler's, the exact solution of the leak with the drive of the sample otherwise.
They are continuous, and the controller's own numbers at the samples. Then the errors obey the
equations of the continuous loop, but for three bounded inputs more: m = u - u_law behind g_n, and
what the steps add to the rates of the estimates. On a box all rates of the loop are bounded, and so
are these.

`held` has the numbers of the implementation, `mismatch` the rates on a box (`ball_rows` is its
arithmetic), `paces` these bounds, `proof` the proof and its
exact check, `search` finds it, `certify` is the certificate, `document` and `premises` are for its
file.
"""
