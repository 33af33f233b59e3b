"""Gains that move between two known ends: a bound for every motion, proven for the whole set.

One inequality for V holds whatever the gains do between the ends, at any speed or at a bounded one,
so it holds for every rule that moves them (`laws/online.py` has two). The paper leaves online
tuning open; these are our theorems.

**Known parameters.** In the coordinates of the plant, xi = x - Pi Y with Pi without a gain in it,
every linear law is one K and one r, and the law at level w has K(w) = (1 - w) K_0 + w K_1 and
r(w) likewise. So xi' = sum_j w_j (M_j xi + U_j z), w_j >= 0, w_0 + w_1 = 1.

* At any speed: one P, one alpha, multipliers of its own at each end. V' is a mean of what it is at
  the ends (`ends`).
* With |w'| <= v: P(w) = (1 - w) P_0 + w P_1. With Q_ij = xi^T P_i (M_j xi + U_j z) + alpha/2 xi^T
  P_i xi + what the multipliers of end j add, V' + alpha V - Delta is at most

      sum_ij w_i w_j Q_ij + w'/2 xi^T (P_1 - P_0) xi,   1 = (w_0 + w_1)^2

  which is linear in w'. So for both signs of v: Q_00, Q_11 and Q_01 + Q_10, with the rate's term
  once, once and twice, are negative definite (`rates`).

**Estimates.** P = blkdiag(Pbar, s), so that the update laws cancel whatever ubar is, if both use
the same one. A, B and R have no c_n in them, and of M the entry (n, n) alone: with a coupling
M[n, n-1] has one as well, and what moves both is refused. So

* c_n(t) >= c_lo adds -s (c_n - c_lo) e_n^2 to V': a proof for the smaller end holds for both;
* gbar1(t), gbar2(t) enter V' through their cost alone, which is convex in each: the ends count;
* gbar(t), Gamma(t) stand in V itself. Growing, they take from it; falling at a relative rate of at
  most rho, they add rho V's own part: alpha + rho in the place of alpha, at the smallest gbar and
  Gamma (`adaptation`).

Neither the cascade, whose later stages are of another V, nor peak gains, nor the implemented loop
are covered.
"""
