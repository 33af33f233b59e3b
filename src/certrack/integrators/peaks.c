/* The largest |e_1| of many members of a system, in the lanes of a vector register.
 *
 * Every lane has its own time and its own steps of the pair of Dormand and Prince, and takes the
 * next member when it has finished one: members whose steps have little in common, such as those of
 * hard disturbances of all frequencies, do not wait for one another (those of native.c would).
 * Between the ends of a step e_1 is the cubic with its values and rates there.
 *
 * `system.h` is generated. It holds the sizes STATES WATCHED PARAMETERS, the coefficients A, B, C,
 * E of the method, constants of step_control.py, how a member ended, and
 *   rates(t, x, p, k, e)    k = x', e = (e_1, e_1')
 */
#include "vector_math.h"
#include "system.h"

enum { NODES = 7 };

/* A squared error of less counts as the first, one of more as the second. */
static const double SMALLEST = 1e-30, LARGEST = 1e18;

/* The first step, and the shortest, as parts of the time that is integrated over. */
static const double FIRST = 1e-5, SHORTEST = 1e-12;

typedef struct {
  int64_t count;
  const double *starts, *parameters; /* rows of `count` */
  double begin, end; /* from when on |e_1| counts, and until when */
  double tolerance, max_state;
  int64_t max_steps; /* of a member */
  double *largest; /* count */
  uint8_t *outcomes; /* count */
  int64_t next; /* member */
} Task;

/* The lanes, and the step from where they are: slopes k and signals e at its nodes. */
typedef struct {
  V x[STATES], p[PARAMETERS + 1], t, h, largest;
  V k[NODES][STATES], e[NODES][2], ends[STATES];
  int64_t member[LANES], steps[LANES]; /* member -1: the lane is idle */
} Lanes;

/* The next member takes a lane; without one the lane stands still at the end. */
static void load(Lanes *g, Task *task, int l) {
  int64_t i = task->next < task->count ? task->next++ : -1;
  g->member[l] = i;
  g->steps[l] = 0;
  g->t[l] = i < 0 ? task->end : 0.0;
  g->h[l] = FIRST * task->end;
  g->largest[l] = 0.0;
  if (i < 0) i = 0; /* numbers that are harmless */
  for (int j = 0; j < STATES; j++) g->x[j][l] = task->starts[j * task->count + i];
  for (int j = 0; j < PARAMETERS; j++) g->p[j][l] = task->parameters[j * task->count + i];
}

INLINE V squared(V error, double allowed, V a, V b) {
  V ratio = error / (allowed * (1.0 + v_max(v_abs(a), v_abs(b))));
  return ratio * ratio;
}

/* The step of all lanes by h; returns the squared errors over the allowed one. */
static V try_step(Lanes *g, const Task *task, V h) {
#pragma GCC unroll 8
  for (int i = 1; i < NODES; i++) {
    for (int j = 0; j < STATES; j++) {
      V sum = SPLAT(0.0);
#pragma GCC unroll 8
      for (int a = 0; a < i; a++)
        if (A[i][a] != 0.0) sum += A[i][a] * g->k[a][j];
      g->ends[j] = g->x[j] + h * sum;
    }
    rates(g->t + C[i] * h, g->ends, g->p, g->k[i], g->e[i]);
  }
  V worst = SPLAT(0.0);
  for (int j = 0; j < STATES; j++) {
    V error = SPLAT(0.0);
#pragma GCC unroll 8
    for (int i = 0; i < NODES; i++)
      if (E[i] != 0.0) error += E[i] * g->k[i][j];
    worst += squared(error * h, task->tolerance, g->x[j], g->ends[j]);
  }
  return worst * (1.0 / STATES);
}

/* By what the next step is longer, from the squared error. */
static V next_factor(V error) {
  error = choose(error < SPLAT(LARGEST), v_max(error, SPLAT(SMALLEST)), SPLAT(LARGEST));
  V factor = SAFETY * v_exp(-0.5 * PER_ORDER * v_log(error));
  return v_min(v_max(factor, SPLAT(MIN_FACTOR)), SPLAT(MAX_FACTOR));
}

/* One step of all lanes; those that end get other members. */
static void go_on(Lanes *g, Task *task) {
  V begin = SPLAT(task->begin), end = SPLAT(task->end);
  V stop = choose(g->t < begin, begin, end), left = stop - g->t, h = v_min(g->h, left);
  V error = try_step(g, task, h), factor = next_factor(error);
  V *first = g->e[0], *last = g->e[NODES - 1];
  V top = v_max(v_max(v_abs(first[0]), v_abs(last[0])),
                v_abs(v_Extremum(first[0], last[0], h * first[1], h * last[1])));
  I good = error <= SPLAT(1.0), counts = good & (g->t >= begin) & (g->t < end);
  g->largest = choose(counts, v_max(top, g->largest), g->largest);
  g->t = choose(good, choose(g->h >= left, stop, g->t + h), g->t);
  /* a step that was cut to end the transient does not shorten the next */
  g->h = choose(good & (h < g->h), v_max(g->h, h * factor), h * factor);
  I outside = (I){0}, large = (I){0};
  for (int j = 0; j < STATES; j++) {
    g->x[j] = choose(good, g->ends[j], g->x[j]);
    g->k[0][j] = choose(good, g->k[NODES - 1][j], g->k[0][j]);
    if (j >= WATCHED) continue;
    outside |= ~(v_abs(g->x[j]) <= SPLAT(task->max_state));
    large |= v_abs(g->x[j]) > SPLAT(ESCAPING);
  }
  for (int j = 0; j < 2; j++) first[j] = choose(good, last[j], first[j]);
  I stuck = ~good & (h <= SPLAT(SHORTEST * task->end)), ended = outside | stuck | (g->t >= end);
  I fresh = (I){0};
  for (int l = 0; l < LANES; l++) {
    int64_t i = g->member[l];
    if (i < 0 || (++g->steps[l] < task->max_steps && !ended[l])) continue;
    int finished = g->t[l] >= task->end && !outside[l];
    int escaped = outside[l] || large[l]; /* a large state that no step serves is escaping */
    task->largest[i] = g->largest[l];
    task->outcomes[i] = (uint8_t)(finished ? FINISHED : escaped ? ESCAPED : RUN_ALONE);
    load(g, task, l);
    fresh[l] = -1;
  }
  if (!any(fresh)) return;
  V k[STATES], e[2];
  rates(g->t, g->x, g->p, k, e);
  for (int j = 0; j < STATES; j++) g->k[0][j] = choose(fresh, k[j], g->k[0][j]);
  for (int j = 0; j < 2; j++) first[j] = choose(fresh, e[j], first[j]);
}

/* Integrate all members; returns 0, or -1 without memory. */
int integrate(Task *task) {
  Lanes *g = NULL;
  if (posix_memalign((void **)&g, 64, sizeof *g)) return -1;
  memset(g, 0, sizeof *g);
  for (int l = 0; l < LANES; l++) load(g, task, l);
  rates(g->t, g->x, g->p, g->k[0], g->e[0]);
  for (int busy = 1; busy;) {
    go_on(g, task);
    busy = 0;
    for (int l = 0; l < LANES; l++) busy |= g->member[l] >= 0;
  }
  free(g);
  return 0;
}
