/* The explicit steps of native.c: method DOP853, shared by the lanes of a group.
 *
 * It defines PER_ORDER, one over the power of the step with which its error grows, and
 *   end_of_step(block, h, tolerance, k, ends)   ends of a block's step; returns the error estimate
 *   try_step(group, tolerance, step)            one step of a group; returns the largest estimate
 * as implicit_step.h does, which stands in its place for a stiff system.
 */
static const double PER_ORDER = 0.125;

/* The end of a block's step; returns the error estimate. */
INLINE V end_of_step(const Block *g, double h, double tolerance, V (*k)[STATES], V *ends) {
  V third = SPLAT(0.0), fifth = SPLAT(0.0);
  for (int j = 0; j < STATES; j++) {
    V sum = SPLAT(0.0), e3 = SPLAT(0.0), e5 = SPLAT(0.0);
#pragma GCC unroll 16
    for (int i = 0; i < STAGES; i++) {
      if (B[i] != 0.0) sum += B[i] * k[i][j];
      if (E3[i] != 0.0) e3 += E3[i] * k[i][j];
      if (E5[i] != 0.0) e5 += E5[i] * k[i][j];
    }
    ends[j] = g->x[j] + h * sum;
    V scale = rough_inverse(1.0 + v_max(v_abs(g->x[j]), v_abs(ends[j])));
    e3 *= scale;
    e5 *= scale;
    third += e3 * e3;
    fifth += e5 * e5;
  }
  return h / tolerance * fifth *
         rough_inverse(v_sqrt((fifth + THIRD_ORDER_WEIGHT * third) * STATES + 1e-300));
}

/* One step: slopes of the stages, ends, rise of the integrals, integrands at the end; returns the
 * largest error estimate of members that are alive. */
OUTLINE double try_step(const Group *g, double tolerance, Step *s) {
  double h = s->h, (*c)[COMMON + 1] = s->c;
  V x[STATES], r[INTEGRALS + 1], worst = SPLAT(0.0);
  EACH_BLOCK(b) {
    /* first same as last; memcpy would move half registers, which cannot be forwarded */
    for (int j = 0; j < STATES; j++) s->k[b][0][j] = g->block[b].k[j];
    for (int j = 0; j < INTEGRALS; j++) s->q[b][j] = B[0] * g->block[b].r[j];
  }
#pragma GCC unroll 16
  for (int i = 1; i < STAGES; i++)
    EACH_BLOCK(b) {
      stage(&g->block[b], h, i, s->k[b], x);
      rates(g->s, c[i], x, g->block[b].p, s->k[b][i], r);
      for (int j = 0; j < INTEGRALS && B[i] != 0.0; j++) s->q[b][j] += B[i] * r[j];
    }
  EACH_BLOCK(b) {
    const Block *block = &g->block[b];
    V error = end_of_step(block, h, tolerance, s->k[b], s->ends[b]);
    error = choose(error == error, error, SPLAT(INFINITY));
    worst = v_max(worst, choose(block->alive, error, SPLAT(0.0)));
    for (int j = 0; j < INTEGRALS; j++) s->q[b][j] *= h;
    rates(g->s, c[STAGES], s->ends[b], block->p, s->k[b][STAGES], s->r[b]);
  }
  double largest = 0.0;
  for (int l = 0; l < LANES; l++) largest = worst[l] > largest ? worst[l] : largest;
  return largest;
}
