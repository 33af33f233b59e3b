/* Many members of one plant under a sampled controller, in the lanes of vector registers.
 *
 * Eight members make a group that shares its steps. Between two events the input is constant and a
 * group takes one step of the pair of Dormand and Prince; lanes whose error estimate demands it
 * take several, as short as the most difficult of them needs (run.py does the same).
 *
 * `system.h` is generated. It holds the sizes
 *   STATES CONTROLLER MEASURED PARAMETERS SHARED COMMON LAW_COMMON TOTALS SHOWN,
 * the coefficients A, B, C, E of the method, the constants of run.py, how a member ended (FINISHED
 * ESCAPED RUN_ALONE), and
 *   common(t, s, c), law_common(t, s, c)  what depends on time t and the segment's numbers s alone
 *   rates(c, x, u, p, k, e)               k = x', e = (e_1, e_1')
 *   measure(x, p, m)                      what the sensors would give
 *   law(c, m, p, k, u)                    the command u; k are the controller's states
 *   total(t, h, s, e, sums, u, p, y)      totals y after a step; e at begin and end, sums over it
 *   shown(c, x, p, u, v)                  what is kept at a time of interest
 */
#include "vector_math.h"
#include "system.h"
#ifdef PLANNED
#include "plan.h"
#endif

enum { NODES = 7, SAMPLE = 1, ACT = 2 };

/* A squared error of less counts as this much: the next step is as long as it may be. */
static const double SMALLEST = 1e-30;

/* When no step is short enough for some lanes, the others go on with this part of the interval. */
static const double RESTART = 1e-6;

typedef uint64_t U __attribute__((vector_size(8 * LANES)));

typedef struct {
  int64_t count;
  const double *starts, *controllers, *totals, *parameters; /* rows of `count` */
  const uint64_t *keys; /* of the noise of each member */
  int64_t events;
  const double *times;
  const double *clock; /* of samples as the controller knows them: without jitter */
  const uint8_t *kinds; /* SAMPLE, ACT */
  const int32_t *marks; /* number of the time of interest, or -1 */
  const int32_t *segments; /* which row of `shared` holds from an event on */
  const double *shared; /* segments x SHARED */
  int64_t depth; /* commands that may wait, and one */
  const double *noise, *noise_bound, *quantum; /* MEASURED each */
  const double *errors; /* samples x MEASURED, or none */
  double input_quantum, input_low, input_high; /* of the converter */
  double initial_input, tolerance, max_state;
  double *values; /* times of interest x SHOWN x count */
  double *end_totals; /* (TOTALS + 1) x count; the last row is the variation of the input */
  double *ends; /* count */
  uint8_t *outcomes; /* count */
#ifdef PLANNED
  Plan plan; /* that all members share */
#endif
} Task;

/* The state of a group at an event. */
typedef struct {
  V x[STATES], k[CONTROLLER + 1], y[TOTALS], p[PARAMETERS + 1], u, variation;
  I alive;
  U key;
  int64_t samples, commands; /* so far; those that began to act */
} Group;

/* A step and what depends on time alone at its nodes. */
typedef struct {
  double t, h;
  const double *s;
  V c[NODES][COMMON + 1];
} Step;

static void prepare(Step *step, double t, double h, const double *s) {
  step->t = t;
  step->h = h;
  step->s = s;
  if (!COMMON) return;
  V when, values[COMMON + 1];
  for (int i = 0; i < LANES; i++) when[i] = t + h * C[i < NODES ? i : 0];
  common(when, s, values);
  for (int i = 0; i < NODES; i++)
    for (int j = 0; j < COMMON; j++) step->c[i][j] = SPLAT(values[j][i]);
}

/* The square of an error over the allowed one, at a step from a to b. */
INLINE V squared(V error, double allowed, V a, V b) {
  V ratio = error / (allowed * (1.0 + v_max(v_abs(a), v_abs(b))));
  return ratio * ratio;
}

/* One step: states and totals after it; returns the squared error over the allowed one, that of the
 * integral of e_1 among them: a reference may be faster than the plant. */
OUTLINE V try_step(const Group *g, const Step *step, double allowed, V *ends, V *y) {
  V k[NODES][STATES], e[NODES][2], x[STATES];
  double h = step->h;
  rates(step->c[0], g->x, g->u, g->p, k[0], e[0]);
#pragma GCC unroll 8
  for (int i = 1; i < NODES; i++) {
    for (int j = 0; j < STATES; j++) {
      V sum = SPLAT(0.0);
#pragma GCC unroll 8
      for (int a = 0; a < i; a++)
        if (A[i][a] != 0.0) sum += A[i][a] * k[a][j];
      x[j] = g->x[j] + h * sum;
    }
    rates(step->c[i], x, g->u, g->p, k[i], e[i]);
  }
  V worst = SPLAT(0.0), sums[2] = {SPLAT(0.0), SPLAT(0.0)}, missed = SPLAT(0.0);
  for (int j = 0; j < STATES; j++) {
    V error = SPLAT(0.0);
#pragma GCC unroll 8
    for (int i = 0; i < NODES; i++)
      if (E[i] != 0.0) error += E[i] * k[i][j];
    worst += squared(error * h, allowed, g->x[j], x[j]);
    ends[j] = x[j];
  }
#pragma GCC unroll 8
  for (int i = 0; i < NODES; i++)
    if (E[i] != 0.0) missed += E[i] * e[i][0];
  worst += squared(missed * h, allowed, e[0][0], e[NODES - 1][0]);
#pragma GCC unroll 8
  for (int i = 0; i < NODES - 1; i++)
    if (B[i] != 0.0) {
      sums[0] += B[i] * e[i][0] * e[i][0];
      sums[1] += B[i] * e[i][0];
    }
  sums[0] *= h;
  sums[1] *= h;
  V sides[4] = {e[0][0], e[NODES - 1][0], e[0][1], e[NODES - 1][1]};
  memcpy(y, g->y, sizeof g->y);
  total(SPLAT(step->t), SPLAT(h), step->s, sides, sums, g->u, g->p, y);
  return worst * (1.0 / STATES);
}

static void remove_lanes(Group *g, const Task *task, int64_t first, I which, int outcome,
                         double t) {
  which &= g->alive;
  g->alive &= ~which;
  for (int l = 0; l < LANES; l++)
    if (which[l] && first + l < task->count) {
      task->ends[first + l] = t;
      task->outcomes[first + l] = (uint8_t)outcome;
    }
}

/* By what the next step is longer, from the squared error. */
static double next_factor(double error, double max_factor) {
  double finite = error > SMALLEST ? error : error == error ? SMALLEST : NOT_A_NUMBER;
  double factor = SAFETY * pow(finite, -0.5 * PER_ORDER);
  return factor < MIN_FACTOR ? MIN_FACTOR : factor > max_factor ? max_factor : factor;
}

static double largest(V error, I which) {
  double worst = 0.0;
  for (int l = 0; l < LANES; l++)
    if (which[l] && !(error[l] <= worst)) worst = error[l] == error[l] ? error[l] : INFINITY;
  return worst;
}

/* Lanes that no step serves: those with a large state are escaping. */
static void give_up(Group *g, const Group *now, const Task *task, int64_t first, I lost, double t) {
  I large = (I){0};
  for (int j = 0; j < STATES; j++) large |= v_abs(now->x[j]) > SPLAT(ESCAPING);
  remove_lanes(g, task, first, lost & large, ESCAPED, t);
  remove_lanes(g, task, first, lost, RUN_ALONE, t);
}

/* Lanes that need several steps for an interval; the others keep what they have. */
OUTLINE void substep(Group *g, const Task *task, int64_t first, double begin, double end,
                     const double *s, I late, V error, V *ends, V *y) {
  Group trial = *g;
  Step step;
  V x[STATES], after[TOTALS];
  double t = begin, h = (end - begin) * next_factor(largest(error, late), FIRST_MAX_FACTOR);
  double shortest = SHORTEST_STEP * end;
  for (int64_t i = 0; i < MAX_INTERVAL_STEPS && t < end && any(late); i++) {
    int last = t + h >= end * (1 - END_ROUNDING);
    h = last ? end - t : h > shortest ? h : shortest;
    int at_shortest = h <= shortest;
    prepare(&step, t, h, s);
    double allowed = (at_shortest ? 1.0 : ERROR_SHARE) * task->tolerance;
    V estimate = try_step(&trial, &step, allowed, x, after);
    double worst = largest(estimate, late);
    if (worst <= 1.0) {
      memcpy(trial.x, x, sizeof x);
      memcpy(trial.y, after, sizeof after);
      t = last ? end : t + h;
    }
    h *= next_factor(worst, MAX_FACTOR);
    if (at_shortest && !(worst <= 1.0)) { /* nothing is short enough for these */
      I lost = late & ~(estimate <= SPLAT(1.0));
      give_up(g, &trial, task, first, lost, begin);
      late &= ~lost;
      h = (end - begin) * RESTART;
    }
  }
  if (t < end) give_up(g, &trial, task, first, late, begin);
  for (int j = 0; j < STATES; j++) ends[j] = choose(late, trial.x[j], ends[j]);
  for (int j = 0; j < TOTALS; j++) y[j] = choose(late, trial.y[j], y[j]);
}

/* A standard normal number of a member's key and a counter: SplitMix64, Box and Muller. */
INLINE V normal(U key, uint64_t counter) {
  U z = key + counter * 0x9e3779b97f4a7c15u;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  z = z ^ (z >> 31);
  V high = __builtin_convertvector((I)(z >> 32), V);
  V low = __builtin_convertvector((I)(z & 0xffffffffu), V);
  return v_sqrt(-2.0 * v_log((high + 0.5) * 0x1p-32)) * v_cos(low * (0x1p-32 * 6.283185307179586));
}

/* Measure, evaluate the law; the command waits for the actuator. */
static void take_sample(Group *g, const Task *task, double t, const double *s, V *waiting) {
  V m[MEASURED], c[LAW_COMMON + 1], u;
  measure(g->x, g->p, m);
  for (int j = 0; j < MEASURED; j++) {
    if (task->noise[j] > 0.0 || task->errors) {
      V bound = SPLAT(task->noise_bound[j]), error = SPLAT(0.0);
      if (task->noise[j] > 0.0)
        error = task->noise[j] * normal(g->key, (uint64_t)(g->samples * MEASURED + j + 1));
      if (task->errors) error += task->errors[g->samples * MEASURED + j];
      m[j] += choose(error > bound, bound, choose(error < -bound, -bound, error));
    }
    if (task->quantum[j] > 0.0) m[j] = rounded(m[j], task->quantum[j]);
  }
  law_common(SPLAT(t), s, c);
#ifdef PLANNED
  V base[MEASURED + 1];
  plan_base(SPLAT(t), s, m, g->p, g->k, base);
#endif
  law(c, m, g->p, g->k, &u);
#ifdef PLANNED
  for (int l = 0; l < LANES; l++) {
    double now = u[l], of_lane[MEASURED + 1];
    for (int j = 0; j <= MEASURED; j++) of_lane[j] = base[j][l];
    u[l] = keep_plan_limits(&task->plan, g->samples, of_lane, &now) ? now : NAN;
  }
#endif
  if (task->input_quantum > 0.0) {
    V low = SPLAT(task->input_low), high = SPLAT(task->input_high);
    u = rounded(u, task->input_quantum);
    u = choose(u < low, low, choose(u > high, high, u)); /* what is not a number stays so */
  }
  waiting[g->samples++ % task->depth] = u;
}

static void store_shown(const Group *g, const Task *task, int64_t first, double t, const double *s,
                        int64_t mark) {
  V c[COMMON + 1], v[SHOWN];
  common(SPLAT(t), s, c);
  shown(c, g->x, g->p, g->u, v);
  for (int j = 0; j < SHOWN; j++) {
    double *place = task->values + (mark * SHOWN + j) * task->count + first;
    for (int l = 0; l < LANES && first + l < task->count; l++)
      place[l] = g->alive[l] ? v[j][l] : NAN;
  }
}

/* Members first ... first + 7 through all events. */
static void integrate_group(const Task *task, int64_t first, Group *g, V *waiting) {
  memset(g, 0, sizeof *g);
  for (int l = 0; l < LANES; l++) {
    int64_t i = first + l < task->count ? first + l : task->count - 1;
    for (int j = 0; j < STATES; j++) g->x[j][l] = task->starts[j * task->count + i];
    for (int j = 0; j < CONTROLLER; j++) g->k[j][l] = task->controllers[j * task->count + i];
    for (int j = 0; j < TOTALS; j++) g->y[j][l] = task->totals[j * task->count + i];
    for (int j = 0; j < PARAMETERS; j++) g->p[j][l] = task->parameters[j * task->count + i];
    g->key[l] = task->keys[i];
  }
  g->alive = ~(I){0};
  g->u = SPLAT(task->initial_input);
  Step step;
  V ends[STATES], y[TOTALS];
  for (int64_t k = 0; k < task->events; k++) {
    double t = task->times[k];
    const double *s = task->shared + task->segments[k] * SHARED;
    if (task->kinds[k] & SAMPLE) take_sample(g, task, task->clock[k], s, waiting);
    if (task->kinds[k] & ACT) {
      V u = waiting[g->commands++ % task->depth];
      if (k) g->variation += v_abs(u - g->u);
      g->u = u;
    }
    if (task->marks[k] >= 0) store_shown(g, task, first, t, s, task->marks[k]);
    if (k + 1 == task->events) break;
    double end = task->times[k + 1], h = end - t;
    prepare(&step, t, h, s);
    V error = try_step(g, &step, ERROR_SHARE * task->tolerance, ends, y);
    I late = ~(error <= SPLAT(1.0)) & g->alive;
    if (any(late)) substep(g, task, first, t, end, s, late, error, ends, y);
    memcpy(g->y, y, sizeof y);
    I outside = (I){0};
    for (int j = 0; j < STATES; j++) {
      g->x[j] = ends[j];
      outside |= ~(v_abs(ends[j]) <= SPLAT(task->max_state));
    }
    if (any(outside & g->alive)) remove_lanes(g, task, first, outside, ESCAPED, t);
    if (!any(g->alive)) {
      for (k++; k < task->events; k++)
        if (task->marks[k] >= 0) store_shown(g, task, first, 0.0, s, task->marks[k]);
      break;
    }
  }
  remove_lanes(g, task, first, ~(I){0}, FINISHED, task->times[task->events - 1]);
  for (int l = 0; l < LANES && first + l < task->count; l++) {
    double *total = task->end_totals + first + l;
    for (int j = 0; j < TOTALS; j++, total += task->count) *total = g->y[j][l];
    *total = g->variation[l];
  }
}

/* Integrate all members of a task; returns 0, or -1 without memory. */
int integrate(const Task *task) {
  Group *g = NULL;
  V *waiting = NULL;
  if (posix_memalign((void **)&waiting, 64, (size_t)task->depth * sizeof *waiting) ||
      posix_memalign((void **)&g, 64, sizeof *g)) {
    free(waiting);
    return -1;
  }
  for (int64_t first = 0; first < task->count; first += LANES)
    integrate_group(task, first, g, waiting);
  free(waiting);
  free(g);
  return 0;
}
