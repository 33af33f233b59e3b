/* The linearly implicit steps of native.c for stiff systems: Rosenbrock method Rodas5P, shared by
 * the lanes of a group.
 *
 * A step of length h from x(t), with the Jacobian J and the derivative d of the rates by time at its
 * begin, solves for every stage i
 *   (1/GAMMA - h J) k_i = f(t + C_i h, x + h sum_j A_ij k_j) + sum_j COUPLING_ij k_j + h SLOPE_i d
 * with the same matrix, and ends at x + h sum_i B_i k_i. Integrals are sums over the dense output:
 * a stage may be far from the solution, which a square of the input would not forgive. `system.h`
 * also holds
 *   INSIDE, PARTS                       weights of the slopes at POINTS inside a step, whose times
 *                                       C[STAGES + 1 ...] are, and their parts of an integral
 *   integrands(s, c, x, p, q)
 *   forces(s, c, p, w)                  what depends on time and the member alone
 *   forced_rates(s, c, w, x, p, k)      k = x'
 *   linearise(s, c, w, x, p, k, j, d)   the same; its derivatives by the states that are not zero
 *                                       everywhere, and those by time
 *   factorise(h, j, m)                  the matrix as triangular factors m; in which lanes they hold
 *   solve(m, d, weight, f)              from the right-hand sides f, plus weight d, to the solution
 * where pivots are those of the diagonal, in an order that keeps zeros zero. As h falls the matrix
 * becomes 1/GAMMA, so a lane whose pivot is too small takes a shorter step like one whose error is
 * too large. A negative one is too small: behind it is a real pole of the right half plane that the
 * step is too long for, and L-stable steps would damp what grows.
 */
static const double PER_ORDER = 0.2;

/* The end of a block's step, and the slope there by the dense output; returns the error estimate. */
INLINE V end_of_step(const Block *g, double h, double tolerance, V (*k)[STATES], V *ends) {
  V squares = SPLAT(0.0);
  for (int j = 0; j < STATES; j++) {
    V sum = SPLAT(0.0), error = SPLAT(0.0), slope = SPLAT(0.0);
#pragma GCC unroll 16
    for (int i = 0; i < STAGES; i++) {
      sum += B[i] * k[i][j];
      if (E[i] != 0.0) error += E[i] * k[i][j];
      slope += END_SLOPE[i] * k[i][j];
    }
    ends[j] = g->x[j] + h * sum;
    k[STAGES][j] = slope;
    error *= rough_inverse(1.0 + v_max(v_abs(g->x[j]), v_abs(ends[j])));
    squares += error * error;
  }
  return h / tolerance * v_sqrt(squares * (1.0 / STATES));
}

/* Rise of the integrals; a step begins with its own integrands. */
INLINE void add_up(const Group *g, Step *s, int b) {
  for (int j = 0; j < INTEGRALS; j++) s->q[b][j] = s->r[b][j] = SPLAT(0.0);
#pragma GCC unroll 16
  for (int n = 0; n < POINTS; n++) {
    V x[STATES], q[INTEGRALS + 1];
    for (int j = 0; j < STATES; j++) x[j] = SPLAT(0.0);
#pragma GCC unroll 16
    for (int i = 0; i < STAGES; i++)
      for (int j = 0; j < STATES; j++) x[j] += INSIDE[n][i] * s->k[b][i][j];
    for (int j = 0; j < STATES; j++) x[j] = g->block[b].x[j] + s->h * x[j];
    integrands(g->s, s->c[STAGES + 1 + n], x, g->block[b].p, q);
    for (int j = 0; j < INTEGRALS; j++) s->q[b][j] += s->h * PARTS[n] * q[j];
  }
}

/* One step: slopes of the stages, ends, rise of the integrals; returns the largest error estimate of
 * members that are alive. */
OUTLINE double try_step(const Group *g, double tolerance, Step *s) {
  double h = s->h, (*c)[COMMON + 1] = s->c;
  V m[BLOCKS][FACTORS], d[BLOCKS][TIMED + 1], w[STAGES][BLOCKS][FORCES + 1], worst = SPLAT(0.0);
  I sound[BLOCKS];
#pragma GCC unroll 16
  for (int i = 0; i < STAGES; i++)
    EACH_BLOCK(b) {
      const Block *block = &g->block[b];
      V f[STATES], *force = w[SAME_TIME[i]][b];
      if (SAME_TIME[i] == i) forces(g->s, c[i], block->p, force);
      if (i == 0) {
        V j[NONZEROS + 1];
        linearise(g->s, c[0], force, block->x, block->p, f, j, d[b]);
        sound[b] = factorise(h, j, m[b]);
      } else {
        V x[STATES];
        stage(block, h, i, s->k[b], x);
        forced_rates(g->s, c[i], force, x, block->p, f);
      }
#pragma GCC unroll 16
      for (int a = 0; a < i; a++)
        for (int j = 0; j < STATES; j++) f[j] += COUPLING[i][a] * s->k[b][a][j];
      solve(m[b], d[b], h * SLOPE[i], f);
      for (int j = 0; j < STATES; j++) s->k[b][i][j] = f[j];
    }
  EACH_BLOCK(b) {
    const Block *block = &g->block[b];
    for (int j = 0; j < STATES; j++)
      s->k[b][STAGES - 1][j] = choose(sound[b], s->k[b][STAGES - 1][j], SPLAT(NAN));
    V error = end_of_step(block, h, tolerance, s->k[b], s->ends[b]);
    error = choose(error == error, error, SPLAT(INFINITY));
    worst = v_max(worst, choose(block->alive, error, SPLAT(0.0)));
    add_up(g, s, b);
  }
  double largest = 0.0;
  for (int l = 0; l < LANES; l++) largest = worst[l] > largest ? worst[l] : largest;
  return largest;
}
