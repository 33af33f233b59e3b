/* Many members of one system in the lanes of vector registers.
 *
 * Explicit Runge-Kutta pair DOP853 (Hairer, Norsett, Wanner, Solving Ordinary Differential Equations
 * I, II.5 and II.6): order 8, error control of orders 5 and 3, dense output of order 7. Eight
 * members make a group that shares its steps, as short as the most difficult of them needs: then
 * what depends on time alone is computed once, for eight stages in the lanes of one register.
 *
 * `system.h` is generated. It holds the sizes
 *   STATES WATCHED PARAMETERS SHARED COMMON INTEGRALS SIGNALS MEMORIES SHOWN,
 * the coefficients A, B, C, E3, E5, D of the method, ESCAPING (a state larger than this where steps
 * vanish is escaping), and
 *   common(t, s, c)              what depends on time t and the segment's numbers s alone
 *   rates(c, x, p, k, q)         k = x', q = integrands
 *   signals(c, x, p, k, y)       what the memories look at
 *   memories(t, h, c, p, y, y_end, m)   update over an interval of length h that begins at t
 *   shown(x, y, v)               what is counted at every time of the grid
 * with p the parameters of a member.
 */
#include "vector_math.h"
#include "system.h"

static const double SAFETY = 0.9, SHRINK = 0.2, GROW = 6.0;

/* The memories see at least so many nodes of a step, times of the grid among them. */
enum { PARTS = 4 };

/* How a member ended; known to the caller. */
enum { FINISHED, ESCAPED, STUCK };

/* Nodes of a step: the stages, its end, and those of the dense output. */
enum { NODES = (ALL_STAGES + LANES - 1) / LANES * LANES };

typedef struct {
  int64_t count, pitch; /* members; length of a row of `values`, whole groups at least */
  const double *starts, *parameters; /* STATES x count, PARAMETERS x count */
  int64_t segments;
  const double *edges; /* segments + 1 times */
  const double *shared; /* segments x SHARED */
  int64_t points;
  const double *grid; /* times; the first is the start */
  const double *centre, *pace; /* SHOWN x points, SHOWN: (value - centre) pace is kept */
  double tolerance, limit;
  int64_t most; /* steps of a group */
  float *values; /* points x SHOWN x pitch */
  double *totals; /* (INTEGRALS + MEMORIES) x count */
  double *ends; /* count */
  uint8_t *outcomes; /* count */
  int64_t *steps; /* of all groups together */
} Task;

/* A group on its way. */
typedef struct {
  double t, at; /* begin of the step; last node that the memories have seen */
  int64_t next, steps; /* time of the grid; steps tried */
  I alive;
  V x[STATES], k[STATES], p[PARAMETERS + 1];
  V q[INTEGRALS + 1], r[INTEGRALS + 1]; /* integrals, integrands at t */
  V y[SIGNALS], m[MEMORIES];
} Group;

static void common_at(double t, const double *s, V *c) { common(SPLAT(t), s, c); }

/* What depends on time alone at the nodes of a step. */
static void common_along(double t, double h, const double *s, V (*c)[COMMON + 1]) {
  for (int i = 0; i < NODES; i += LANES) {
    V when, found[COMMON + 1];
    for (int l = 0; l < LANES; l++) when[l] = t + h * C[i + l < ALL_STAGES ? i + l : 0];
    common(when, s, found);
    for (int j = 0; j < COMMON; j++)
      for (int l = 0; l < LANES; l++) c[i + l][j] = SPLAT(found[j][l]);
  }
}

INLINE void stage(const Group *g, double h, int i, V (*k)[STATES], V *x) {
  for (int j = 0; j < STATES; j++) x[j] = SPLAT(0.0);
#pragma GCC unroll 16
  for (int a = 0; a < i; a++)
    if (A[i][a] != 0.0)
      for (int j = 0; j < STATES; j++) x[j] += A[i][a] * k[a][j];
  for (int j = 0; j < STATES; j++) x[j] = g->x[j] + h * x[j];
}

/* One step: ends, slopes of the stages, rise of the integrals, integrands at the end; returns the
 * error estimate. */
OUTLINE V advance(const Group *g, double h, double tolerance, V (*c)[COMMON + 1], V *ends,
                  V (*k)[STATES], V *q, V *r) {
  V x[STATES], total[INTEGRALS + 1];
  memcpy(k[0], g->k, sizeof k[0]); /* first same as last */
  for (int j = 0; j < INTEGRALS; j++) total[j] = B[0] * g->r[j];
#pragma GCC unroll 16
  for (int i = 1; i < STAGES; i++) {
    stage(g, h, i, k, x);
    rates(c[i], x, g->p, k[i], r);
    for (int j = 0; j < INTEGRALS; j++) total[j] += B[i] * r[j];
  }
  for (int j = 0; j < INTEGRALS; j++) q[j] = h * total[j];
  V third = SPLAT(0.0), fifth = SPLAT(0.0);
  for (int j = 0; j < STATES; j++) {
    V sum = SPLAT(0.0), e3 = SPLAT(0.0), e5 = SPLAT(0.0);
#pragma GCC unroll 16
    for (int i = 0; i < STAGES; i++) {
      sum += B[i] * k[i][j];
      e3 += E3[i] * k[i][j];
      e5 += E5[i] * k[i][j];
    }
    ends[j] = g->x[j] + h * sum;
    V scale = h / (tolerance * (1.0 + v_max(v_abs(g->x[j]), v_abs(ends[j]))));
    e3 *= scale;
    e5 *= scale;
    third += e3 * e3;
    fifth += e5 * e5;
  }
  rates(c[STAGES], ends, g->p, k[STAGES], r);
  return fifth / v_sqrt((fifth + 0.01 * third) * STATES + 1e-300);
}

/* Coefficients of the dense output over a step. */
OUTLINE void prepare(const Group *g, double h, V (*c)[COMMON + 1], const V *ends,
                     V (*k)[STATES], V (*f)[STATES]) {
  V x[STATES], r[INTEGRALS + 1];
#pragma GCC unroll 16
  for (int i = STAGES + 1; i < ALL_STAGES; i++) {
    stage(g, h, i, k, x);
    rates(c[i], x, g->p, k[i], r);
  }
  for (int j = 0; j < STATES; j++) {
    V rise = ends[j] - g->x[j];
    f[0][j] = rise;
    f[1][j] = h * k[0][j] - rise;
    f[2][j] = 2.0 * rise - h * (k[STAGES][j] + k[0][j]);
    for (int d = 0; d < 4; d++) {
      V sum = SPLAT(0.0);
#pragma GCC unroll 16
      for (int i = 0; i < ALL_STAGES; i++)
        if (D[d][i] != 0.0) sum += D[d][i] * k[i][j];
      f[3 + d][j] = h * sum;
    }
  }
}

/* State and its slope at begin + theta h. */
INLINE void dense(const V *x, V (*f)[STATES], double theta, double h, V *found, V *slope) {
  double back = 1.0 - theta;
  for (int j = 0; j < STATES; j++) {
    V v = SPLAT(0.0), d = SPLAT(0.0); /* v and its derivative by theta */
#pragma GCC unroll 8
    for (int i = 6; i >= 0; i--) {
      V sum = v + f[i][j];
      d = i % 2 ? d * back - sum : d * theta + sum;
      v = i % 2 ? sum * back : sum * theta;
    }
    found[j] = x[j] + v;
    slope[j] = d * (1.0 / h);
  }
}

/* The memories see the time `now`; at a time of the grid the shown values are kept. */
OUTLINE void visit(Group *g, const Task *task, int64_t first, double now, const V *c,
                   const V *x, const V *slopes, int shows) {
  V y[SIGNALS];
  signals(c, x, g->p, slopes, y);
  memories(SPLAT(g->at), SPLAT(now - g->at), c, g->p, g->y, y, g->m);
  memcpy(g->y, y, sizeof y);
  g->at = now;
  if (!shows) return;
  V v[SHOWN];
  typedef float F __attribute__((vector_size(4 * LANES)));
  shown(x, y, v);
  int64_t row = g->next++;
  for (int j = 0; j < SHOWN; j++) {
    V reduced = (v[j] - task->centre[j * task->points + row]) * task->pace[j];
    F kept = __builtin_convertvector(choose(g->alive, reduced, SPLAT(NAN)), F);
    float *place = task->values + (row * SHOWN + j) * task->pitch + first;
    memcpy(place, &kept, sizeof kept);
  }
}

static void bury(Group *g, const Task *task, int64_t first, I which, int outcome, double t) {
  which &= g->alive;
  g->alive &= ~which;
  for (int l = 0; l < LANES; l++)
    if (which[l] && first + l < task->count) {
      task->ends[first + l] = t;
      task->outcomes[first + l] = (uint8_t)outcome;
    }
}

/* Longest first step that none of the group objects to. */
static double first_step(const Group *g, double tolerance) {
  V size = SPLAT(0.0), speed = SPLAT(0.0);
  for (int j = 0; j < STATES; j++) {
    V scale = 1.0 / (1.0 + v_abs(g->x[j]));
    size += g->x[j] * g->x[j] * scale * scale;
    speed += g->k[j] * g->k[j] * scale * scale;
  }
  V h = 0.1 * v_sqrt((size + 1e-4) / (speed + 1e-4)) * pow(tolerance, 0.125);
  double least = INFINITY;
  for (int l = 0; l < LANES; l++) least = h[l] < least ? h[l] : least;
  return least < INFINITY ? least : 1e-6;
}

/* Members first ... first + 7 from begin to end; `marks` is what depends on time at the grid. */
static void travel(const Task *task, V (*marks)[COMMON + 1], int64_t first, Group *g) {
  memset(g, 0, sizeof *g);
  for (int l = 0; l < LANES; l++) {
    int64_t i = first + l < task->count ? first + l : task->count - 1;
    for (int j = 0; j < STATES; j++) g->x[j][l] = task->starts[j * task->count + i];
    for (int j = 0; j < PARAMETERS; j++) g->p[j][l] = task->parameters[j * task->count + i];
  }
  g->alive = ~(I){0};
  g->t = g->at = task->edges[0];
  double h = 0.0;
  V c[NODES][COMMON + 1], ends[STATES], k[ALL_STAGES][STATES], f[7][STATES];
  V q[INTEGRALS + 1], r[INTEGRALS + 1], x[STATES], slopes[STATES];
  for (int64_t segment = 0; segment < task->segments; segment++) {
    const double *s = task->shared + segment * SHARED, stop = task->edges[segment + 1];
    common_at(g->t, s, c[0]);
    rates(c[0], g->x, g->p, g->k, g->r);
    if (!segment) {
      signals(c[0], g->x, g->p, g->k, g->y);
      h = first_step(g, task->tolerance);
    }
    int shows = g->next < task->points && task->grid[g->next] == g->t;
    visit(g, task, first, g->t, c[0], g->x, g->k, shows);
    while (g->t < stop && any(g->alive)) {
      int final = h >= (stop - g->t) * (1 - 1e-12);
      double step = final ? stop - g->t : h, end = final ? stop : g->t + step;
      common_along(g->t, step, s, c);
      V error = advance(g, step, task->tolerance, c, ends, k, q, r);
      double worst = 0.0;
      for (int l = 0; l < LANES; l++)
        if (g->alive[l] && !(error[l] <= worst)) worst = error[l] == error[l] ? error[l] : INFINITY;
      double factor = SAFETY * pow(worst + 1e-30, -0.125);
      factor = factor > GROW ? GROW : factor > SHRINK ? factor : SHRINK;
      int hopeless = ++g->steps >= task->most || end <= g->t + 1e-15 * fabs(g->t);
      if (!(worst <= 1.0)) {
        if (hopeless) {
          I bad = g->steps >= task->most ? ~(I){0} : ~(error <= SPLAT(1.0)), large = (I){0};
          for (int j = 0; j < WATCHED; j++) large |= v_abs(g->x[j]) > SPLAT(ESCAPING);
          bury(g, task, first, bad & large, ESCAPED, g->t);
          bury(g, task, first, bad, STUCK, g->t);
        }
        h = step * (factor < 0.9 ? factor : 0.9);
        continue;
      }
      prepare(g, step, c, ends, k, f);
      int last = final && segment + 1 == task->segments; /* an inner edge is shown after its jump */
      int64_t inside = g->next;
      while (inside < task->points && task->grid[inside] < end) inside++;
      int parts = inside - g->next < PARTS ? PARTS : 1;
      for (int part = 1; part <= parts; part++) {
        double until = part < parts ? g->t + step * part / parts : end;
        for (; g->next < inside && task->grid[g->next] <= until;) {
          double now = task->grid[g->next];
          dense(g->x, f, (now - g->t) / step, step, x, slopes);
          visit(g, task, first, now, marks[g->next], x, slopes, 1);
        }
        if (part < parts && g->at < until) {
          V mark[COMMON + 1];
          common_at(until, s, mark);
          dense(g->x, f, (until - g->t) / step, step, x, slopes);
          visit(g, task, first, until, mark, x, slopes, 0);
        }
      }
      int shows = g->next < task->points && task->grid[g->next] == end && (!final || last);
      visit(g, task, first, end, c[STAGES], ends, k[STAGES], shows);
      g->t = end;
      I outside = (I){0};
      for (int j = 0; j < STATES; j++) {
        g->x[j] = ends[j];
        g->k[j] = k[STAGES][j];
        if (j < WATCHED) outside |= ~(v_abs(ends[j]) <= SPLAT(task->limit));
      }
      for (int j = 0; j < INTEGRALS; j++) g->q[j] += q[j], g->r[j] = r[j];
      if (any(outside & g->alive)) bury(g, task, first, outside, ESCAPED, end);
      if (g->steps >= task->most) bury(g, task, first, ~(I){0}, STUCK, end);
      double tried = step * factor;
      h = final && tried < h ? h : tried;
    }
  }
  bury(g, task, first, ~(I){0}, FINISHED, g->t);
  for (int l = 0; l < LANES && first + l < task->count; l++) {
    double *total = task->totals + first + l;
    for (int j = 0; j < INTEGRALS; j++, total += task->count) *total = g->q[j][l];
    for (int j = 0; j < MEMORIES; j++, total += task->count) *total = g->m[j][l];
  }
  *task->steps += g->steps;
}

/* Integrate all members of a task; returns 0, or -1 without memory. */
int integrate(const Task *task) {
  Group *g = NULL;
  V(*marks)[COMMON + 1] = NULL;
  if (posix_memalign((void **)&marks, 64, (size_t)task->points * sizeof *marks) ||
      posix_memalign((void **)&g, 64, sizeof *g)) {
    free(marks);
    return -1;
  }
  int64_t segment = 0;
  for (int64_t k = 0; k < task->points; k++) {
    while (segment + 1 < task->segments && task->grid[k] > task->edges[segment + 1]) segment++;
    common_at(task->grid[k], task->shared + segment * SHARED, marks[k]);
  }
  for (int64_t first = 0; first < task->count; first += LANES) travel(task, marks, first, g);
  free(marks);
  free(g);
  return 0;
}

/* Count reduced values in bins of 1 + |v| by their leading bits (see statistics.py). */
void count(int64_t rows, int64_t members, int64_t pitch, const float *values, int64_t side,
           int32_t bits, int32_t *counts) {
  for (int64_t r = 0; r < rows; r++, values += pitch, counts += 2 * side + 1)
    for (int64_t i = 0; i < members; i++) {
      float v = values[i], y = 1.0f + fabsf(v);
      int32_t pattern;
      memcpy(&pattern, &y, sizeof y);
      int64_t bin = (pattern - (127 << 23)) >> (23 - bits);
      bin = bin < side ? bin : side - 1;
      bin = v < 0 ? side - 1 - bin : side + bin;
      counts[v == v ? bin : 2 * side]++;
    }
}
