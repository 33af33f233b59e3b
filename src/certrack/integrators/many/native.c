/* Many members of one system in the lanes of vector registers.
 *
 * Explicit Runge-Kutta pair DOP853 (Hairer, Norsett, Wanner, Solving Ordinary Differential
 * Equations I, II.5 and II.10): order 8, error control of orders 5 and 3, dense output of order 6.
 * A group of members shares its steps, as short as the most difficult of them needs: then what
 * depends on time alone, the weights of the dense output among it, is computed once for all. The
 * members of a group fill several blocks of lanes, so that the work of one block hides the latency
 * of another.
 *
 * `system.h` is generated. It holds the sizes
 *   BLOCKS (of lanes in a group) STATES WATCHED PARAMETERS SHARED COMMON INTEGRALS SIGNALS
 *   MEMORIES SHOWN STAGES TERMS (of the dense output),
 * the coefficients A, B, C, E3, E5, THIRD_ORDER_WEIGHT, DENSE of the method, ESCAPING (a state
 * larger than this where steps vanish is escaping), how a member ended (FINISHED ESCAPED RUN_ALONE),
 * and
 *   common(t, s, c)              what depends on time t and the segment's numbers s alone
 *   rates(s, c, x, p, k, q)      k = x', q = integrands
 *   signals(s, c, x, p, k, y)    what the memories look at
 *   memories(t, h, s, c, p, y, y_end, m)   update over an interval of length h that begins at t
 *   shown(x, y, v)               what is counted at every time of the grid
 *   surfaces(s, c, x, p, f, d, e)   of the SURFACES states HELD that may stick: what stands for their
 *                                sign, f, and their rates d + e s (integrators/switching.py)
 * with p the parameters of a member, the last of which are its modes: on which side of each surface
 * it is, and whether it is stuck there. The last of the segment's numbers s are those that all
 * members share at all times, such as gains: another value compiles nothing.
 */
#include "vector_math.h"
#include "system.h"

/* The next step is SAFETY of the one whose error would be the allowed one, lest it fail at once; it
 * is no shorter than MIN_FACTOR of the last one and no longer than MAX_FACTOR of it, because an
 * error estimate says little about much longer or shorter steps; after a failure it is SAFETY of it
 * at most. The error grows with the power 1/PER_ORDER of the step. */
static const double SAFETY = 0.9, MIN_FACTOR = 0.2, MAX_FACTOR = 6.0;

/* A step that leaves less than this part of itself to the end of a segment goes there. */
static const double END_ROUNDING = 1e-12;

/* A step shorter than this part of the time does not move it. */
static const double SHORTEST = 1e-15;

/* The memories are updated at nodes no further apart than this part of a step at this tolerance,
 * and the same distance at any other: times of the grid among them. Between nodes signals are taken
 * for cubics, which must not fall behind a method of order 8. */
static const double NODE_SPACING = 1.0 / 3, SPACING_TOLERANCE = 1e-5;

/* A state is on a surface within ON_SURFACE of 1 + |x|. A step is looked at in so many parts for the
 * end of a mode, which is bisected so often. */
static const double ON_SURFACE = 1e-13;
enum { LOOKS = 8, BISECTIONS = 48, SIDES_AT = PARAMETERS - 2 * SURFACES, STUCK_AT = PARAMETERS - SURFACES };

/* More events than MAX_RUSH while the time moves by RUSH of it have no end. */
enum { MAX_RUSH = 5000 };
static const double RUSH = 1e-7;

/* Members of a group, which share their steps. */
enum { GROUP_SIZE = BLOCKS * LANES };

/* Nodes of a step: the stages, its end, and what else its times are. */
enum { TIMES = sizeof C / sizeof *C, NODES = (TIMES + LANES - 1) / LANES * LANES };

/* Members whose bins are gathered before they are counted: few enough for the cache, enough to find
 * the bins of a row in it. A row is not a power of two: rows must not share cache sets. */
enum { BATCH = 8 * GROUP_SIZE, PITCH = BATCH + GROUP_SIZE };

typedef struct {
  int64_t count; /* members */
  const double *starts, *parameters; /* STATES x count, PARAMETERS x count */
  int64_t segments;
  const double *edges; /* segments + 1 times */
  const double *shared; /* segments x SHARED */
  int64_t points;
  const double *grid; /* times; the first is the start */
  const double *centre, *per_unit; /* SHOWN x points, SHOWN: (value - centre) per_unit is counted */
  double tolerance, max_state;
  int64_t max_steps; /* of a group */
  int64_t begin, end; /* the members that are counted */
  int64_t bins_per_side, bits; /* of one side of zero; leading bits of a bin: see statistics.py */
  int32_t *counts; /* points x SHOWN x (2 bins_per_side + 1); other tasks may add to it, too */
  uint16_t *own_counts; /* of the same shape, zero before and after: half as much for the cache */
  double *totals; /* (INTEGRALS + MEMORIES) x count */
  double *finals; /* STATES x count */
  double *ends; /* count */
  uint8_t *outcomes; /* count */
  int64_t *next_member; /* the first that no thread has begun; shared by all threads */
  int64_t steps; /* of all groups together */
  double node_spacing; /* the part of a step between nodes of the memories, at most */
  double (*grid_common)[COMMON + 1]; /* what depends on time alone, on the grid */
  uint16_t *bins; /* points x SHOWN x PITCH */
  struct Filled { uint16_t low, high; } *filled; /* points x SHOWN: what own_counts has besides 0 */
  int64_t members_counted; /* in `own_counts` */
} Task;

/* Members side by side in the lanes. */
typedef struct {
  I alive;
  V x[STATES], k[STATES], p[PARAMETERS + 1];
  V q[INTEGRALS + 1], r[INTEGRALS + 1]; /* integrals, integrands at t */
  V y[SIGNALS], m[MEMORIES];
} Block;

/* The state of a group at the begin of a step. */
typedef struct {
  double t, node; /* begin of the step; last node at which the memories were updated */
  int64_t row, steps; /* next time of the grid; steps tried */
  int64_t first; /* its first member */
  const double *s; /* the segment's numbers */
  int64_t events; /* since `rush` */
  double rush;
  Block block[BLOCKS];
} Group;

/* A step of a group, before it is accepted. */
typedef struct {
  double h, c[NODES][COMMON + 1];
  V k[BLOCKS][STAGES + 1][STATES], ends[BLOCKS][STATES];
  V q[BLOCKS][INTEGRALS + 1], r[BLOCKS][INTEGRALS + 1];
} Step;

#define EACH_BLOCK(b) _Pragma("GCC unroll 1") for (int b = 0; b < BLOCKS; b++)

static void common_at(double t, const double *s, double *c) {
  V values[COMMON + 1];
  common(SPLAT(t), s, values);
  for (int j = 0; j < COMMON; j++) c[j] = values[j][0];
}

/* What depends on time alone at the nodes of a step. */
static void common_along(double t, double h, const double *s, double (*c)[COMMON + 1]) {
  for (int i = 0; i < NODES; i += LANES) {
    V when, values[COMMON + 1];
    for (int l = 0; l < LANES; l++) when[l] = t + h * C[i + l < TIMES ? i + l : 0];
    common(when, s, values);
    for (int j = 0; j < COMMON; j++)
      for (int l = 0; l < LANES; l++) c[i + l][j] = values[j][l];
  }
}

/* Where the rates of a stage are evaluated. */
INLINE void stage(const Block *g, double h, int i, V (*k)[STATES], V *x) {
  for (int j = 0; j < STATES; j++) x[j] = SPLAT(0.0);
#pragma GCC unroll 16
  for (int a = 0; a < i; a++)
    if (A[i][a] != 0.0)
      for (int j = 0; j < STATES; j++) x[j] += A[i][a] * k[a][j];
  for (int j = 0; j < STATES; j++) x[j] = g->x[j] + h * x[j];
}

#ifdef IMPLICIT
#include "implicit_step.h"
#else
#include "explicit_step.h"
#endif

/* Weights of the slopes in the rise of the states until begin + theta h, and in the rate there. */
static void dense_weights(double theta, double h, double *value, double *slope) {
  V v[NODES / LANES] = {0}, d[NODES / LANES] = {0}, row;
  double power = 1.0;
#pragma GCC unroll 8
  for (int i = 0; i < TERMS; i++, power *= theta)
    for (int l = 0; l < NODES / LANES; l++) {
      memcpy(&row, DENSE[i] + l * LANES, sizeof row);
      v[l] += h * theta * power * row;
      d[l] += (i + 1) * power * row;
    }
  memcpy(value, v, sizeof v);
  memcpy(slope, d, sizeof d);
}

INLINE H *bin_place(const Task *task, const Group *g, int64_t row, int j, int b) {
  return (H *)(task->bins + (row * SHOWN + j) * PITCH + g->first % BATCH + b * LANES);
}

/* Update the memories of a block at the time `now`; at a time of the grid store its bins. */
INLINE void update(Group *g, const Task *task, int b, double now, const double *c, const V *x,
                   const V *slopes, int shows) {
  Block *block = &g->block[b];
  V y[SIGNALS], v[SHOWN];
  signals(g->s, c, x, block->p, slopes, y);
  memories(g->node, now - g->node, g->s, c, block->p, block->y, y, block->m);
  for (int j = 0; j < SIGNALS; j++) block->y[j] = y[j];
  if (!shows) return;
  shown(x, y, v);
  for (int j = 0; j < SHOWN; j++) {
    V reduced = (v[j] - task->centre[j * task->points + g->row]) * task->per_unit[j];
    *bin_place(task, g, g->row, j, b) =
        bins_of(__builtin_convertvector(reduced, F), block->alive, (int)task->bins_per_side,
                (int)task->bits);
  }
}

/* The same at a time inside a step, by the dense output. */
OUTLINE void update_inside(Group *g, const Task *task, Step *s, double now, const double *c,
                           int shows) {
  double value[NODES], slope[NODES];
  dense_weights((now - g->t) / s->h, s->h, value, slope);
  EACH_BLOCK(b) {
    V x[STATES], d[STATES];
    for (int j = 0; j < STATES; j++) x[j] = g->block[b].x[j], d[j] = SPLAT(0.0);
#pragma GCC unroll 16
    for (int i = 0; i <= STAGES; i++)
      if (DENSE[1][i] != 0.0)
        for (int j = 0; j < STATES; j++) {
          x[j] += value[i] * s->k[b][i][j];
          d[j] += slope[i] * s->k[b][i][j];
        }
    update(g, task, b, now, c, x, d, shows);
  }
  g->node = now;
  g->row += shows;
}

/* The same at the begin of a segment or the end of the run, where the group is. */
OUTLINE void update_at_edge(Group *g, const Task *task, const double *c, int ends) {
  int shows = g->row < task->points && task->grid[g->row] == g->t && ends;
  EACH_BLOCK(b) update(g, task, b, g->t, c, g->block[b].x, g->block[b].k, shows);
  g->node = g->t;
  g->row += shows;
}

/* What is negative where the mode of a lane holds no more. */
INLINE void distances(const double *s, const double *c, const V *x, const V *p, V *w) {
  V f[SURFACES + 1], d[SURFACES + 1], e[SURFACES + 1], size = SPLAT(1.0);
  surfaces(s, c, x, p, f, d, e);
  for (int j = 0; j < WATCHED; j++) size = v_max(size, 1.0 + v_abs(x[j]));
  for (int k = 0; k < SURFACES; k++)
    w[k] = choose(p[STUCK_AT + k] > SPLAT(0.0), 1.0 + ON_SURFACE - v_abs(f[k]),
                  p[SIDES_AT + k] * x[HELD[k]] + ON_SURFACE * size);
}

/* The least of it in all lanes at a part theta of a step, by the dense output. */
OUTLINE double least_distance(const Group *g, const Step *s, double theta, const double *shared) {
  double value[NODES], slope[NODES], c[COMMON + 1], least = INFINITY;
  dense_weights(theta, s->h, value, slope);
  common_at(g->t + theta * s->h, shared, c);
  EACH_BLOCK(b) {
    V x[STATES], w[SURFACES + 1];
    for (int j = 0; j < STATES; j++) x[j] = g->block[b].x[j];
#pragma GCC unroll 16
    for (int i = 0; i <= STAGES; i++)
      if (DENSE[1][i] != 0.0)
        for (int j = 0; j < STATES; j++) x[j] += value[i] * s->k[b][i][j];
    distances(shared, c, x, g->block[b].p, w);
    for (int k = 0; k < SURFACES; k++)
      for (int l = 0; l < LANES; l++)
        if (g->block[b].alive[l] && w[k][l] < least) least = w[k][l];
  }
  return least;
}

/* The part of a step after which the first mode of any lane has ended; 2 if all hold. */
static double first_event(const Group *g, const Step *s, const double *shared) {
  double low = 0.0, high = 2.0;
  for (int i = 1; i <= LOOKS && high > 1.0; i++) {
    double theta = (double)i / LOOKS;
    if (least_distance(g, s, theta, shared) < 0.0)
      high = theta;
    else
      low = theta;
  }
  for (int i = 0; i < BISECTIONS && high <= 1.0; i++) {
    double theta = 0.5 * (low + high);
    if (least_distance(g, s, theta, shared) < 0.0)
      high = theta;
    else
      low = theta;
  }
  return high;
}

/* The modes that hold from here on, and the rates in them. A lane on a surface that both sides lead
 * to sticks there; else it leaves to the side that leads away. At the start lanes are where they
 * are; later one that is beyond its side has just come to the surface. */
OUTLINE void settle(Group *g, const double *c, int start) {
  EACH_BLOCK(b) {
    Block *block = &g->block[b];
    V *p = block->p, sign_of[SURFACES + 1], d[SURFACES + 1], e[SURFACES + 1], size = SPLAT(1.0);
    I on[SURFACES + 1];
    for (int j = 0; j < WATCHED; j++) size = v_max(size, 1.0 + v_abs(block->x[j]));
    for (int k = 0; k < SURFACES; k++) {
      V *f = &block->x[HELD[k]], *side = &p[SIDES_AT + k];
      on[k] = (v_abs(*f) <= ON_SURFACE * size) | (p[STUCK_AT + k] > SPLAT(0.0));
      if (!start) on[k] |= *side * *f < SPLAT(0.0);
      *side = choose(on[k], *side, v_sign(*f));
      *f = choose(on[k], SPLAT(0.0), *f);
    }
    surfaces(g->s, c, block->x, p, sign_of, d, e);
    for (int k = 0; k < SURFACES; k++) {
      V up = d[k] + e[k], down = d[k] - e[k], zero = SPLAT(0.0), *side = &p[SIDES_AT + k];
      I holds = on[k] & (up <= zero) & (down >= zero) & (e[k] < zero);
      V away = choose(up > zero, SPLAT(1.0), choose(down < zero, SPLAT(-1.0), *side));
      V mean = choose(d[k] >= zero, SPLAT(1.0), SPLAT(-1.0));
      away = choose((up > zero) & (down < zero), mean, away);
      *side = choose(on[k] & ~holds, away, *side);
      p[STUCK_AT + k] = choose(holds, SPLAT(1.0), zero);
    }
    rates(g->s, c, block->x, p, block->k, block->r);
  }
}

/* Update the memories at all nodes inside a step. */
static void update_along(Group *g, const Task *task, Step *s, const double *shared, double end,
                         double stop) {
  for (;;) {
    double mark = g->row < task->points ? task->grid[g->row] : INFINITY;
    double until = mark < stop ? mark : stop;
    double parts = ceil((until - g->node) / (task->node_spacing * s->h) * 0.999), c[COMMON + 1];
    double now = parts > 1 ? g->node + (until - g->node) / parts : until;
    now = now < g->t ? g->t : now;
    /* where steps vanish, rounding may leave the next node where the last one is */
    if (now > end || now >= stop || (now <= g->node && now < until)) return;
    int shows = now >= mark;
    if (!shows) common_at(now, shared, c);
    update_inside(g, task, s, now, shows ? task->grid_common[g->row] : c, shows);
  }
}

static void remove_lanes(Group *g, const Task *task, int b, I which, int outcome) {
  which &= g->block[b].alive;
  g->block[b].alive &= ~which;
  int64_t first = g->first + b * LANES;
  for (int l = 0; l < LANES; l++)
    if (which[l] && first + l < task->count) {
      task->ends[first + l] = g->t;
      task->outcomes[first + l] = (uint8_t)outcome;
    }
}

/* No step is short enough: lanes whose error is too large are escaping or must be run alone; after
 * too many steps all are. */
static void give_up(Group *g, const Task *task, const Step *s) {
  EACH_BLOCK(b) {
    V *x = g->block[b].x, ends[STATES], k[STAGES + 1][STATES];
    memcpy(k, s->k[b], sizeof k);
    V error = end_of_step(&g->block[b], s->h, task->tolerance, k, ends);
    I bad = g->steps >= task->max_steps ? ~(I){0} : ~(error <= SPLAT(1.0)), large = (I){0};
    for (int j = 0; j < WATCHED; j++) large |= v_abs(x[j]) > SPLAT(ESCAPING);
    remove_lanes(g, task, b, bad & large, ESCAPED);
    remove_lanes(g, task, b, bad, RUN_ALONE);
  }
}

static void accept(Group *g, const Task *task, const Step *s, double end) {
  g->t = end;
  EACH_BLOCK(b) {
    Block *block = &g->block[b];
    I outside = (I){0};
    for (int j = 0; j < STATES; j++) {
      block->x[j] = s->ends[b][j];
      block->k[j] = s->k[b][STAGES][j];
      if (j < WATCHED) outside |= ~(v_abs(block->x[j]) <= SPLAT(task->max_state));
    }
    for (int j = 0; j < INTEGRALS; j++) block->q[j] += s->q[b][j], block->r[j] = s->r[b][j];
    if (any(outside & block->alive)) remove_lanes(g, task, b, outside, ESCAPED);
    if (g->steps >= task->max_steps) remove_lanes(g, task, b, ~(I){0}, RUN_ALONE);
  }
}

/* A first step that is short enough for the whole group: from the time in which the states move by
 * their size (compare Hairer, Norsett, Wanner, II.4). */
static double first_step(const Group *g, double tolerance) {
  double least = INFINITY;
  EACH_BLOCK(b) {
    const Block *block = &g->block[b];
    V size = SPLAT(0.0), speed = SPLAT(0.0);
    for (int j = 0; j < STATES; j++) {
      V scale = 1.0 / (1.0 + v_abs(block->x[j]));
      size += block->x[j] * block->x[j] * scale * scale;
      speed += block->k[j] * block->k[j] * scale * scale;
    }
    V h = 0.1 * v_sqrt((size + 1e-4) / (speed + 1e-4)) * pow(tolerance, PER_ORDER);
    for (int l = 0; l < LANES; l++) least = h[l] < least ? h[l] : least;
  }
  return least < INFINITY ? least : 1e-6;
}

static void load_group(Group *g, const Task *task, int64_t first) {
  memset(g, 0, sizeof *g);
  g->first = first;
  g->t = g->node = task->edges[0];
  EACH_BLOCK(b) {
    Block *block = &g->block[b];
    block->alive = ~(I){0};
    for (int l = 0; l < LANES; l++) {
      int64_t i = first + b * LANES + l;
      i = i < task->count ? i : task->count - 1;
      for (int j = 0; j < STATES; j++) block->x[j][l] = task->starts[j * task->count + i];
      for (int j = 0; j < PARAMETERS; j++) block->p[j][l] = task->parameters[j * task->count + i];
    }
  }
}

static int any_alive(const Group *g) {
  I alive = g->block[0].alive;
  for (int b = 1; b < BLOCKS; b++) alive |= g->block[b].alive;
  return any(alive);
}

/* Integrate a group from begin to end. */
static void integrate_group(const Task *task, Group *g, Step *s) {
  double h = 0.0;
  for (int64_t segment = 0; segment < task->segments; segment++) {
    const double *shared = task->shared + segment * SHARED, stop = task->edges[segment + 1];
    g->s = shared;
    common_at(g->t, shared, s->c[0]);
    EACH_BLOCK(b) {
      Block *block = &g->block[b];
      rates(shared, s->c[0], block->x, block->p, block->k, block->r);
      if (!segment && !SURFACES) signals(shared, s->c[0], block->x, block->p, block->k, block->y);
    }
    if (SURFACES) settle(g, s->c[0], !segment);
    if (SURFACES && !segment)
      EACH_BLOCK(b) {
        Block *block = &g->block[b];
        signals(shared, s->c[0], block->x, block->p, block->k, block->y);
      }
    if (!segment) h = first_step(g, task->tolerance);
    update_at_edge(g, task, s->c[0], 1);
    while (g->t < stop && any_alive(g)) {
      int final = h >= (stop - g->t) * (1 - END_ROUNDING);
      double end = final ? stop : g->t + h;
      s->h = final ? stop - g->t : h;
      common_along(g->t, s->h, shared, s->c);
      double worst = try_step(g, task->tolerance, s);
      double factor = SAFETY * pow(worst + 1e-30, -PER_ORDER);
      factor = factor > MAX_FACTOR ? MAX_FACTOR : factor > MIN_FACTOR ? factor : MIN_FACTOR;
      int hopeless = ++g->steps >= task->max_steps || end <= g->t + SHORTEST * fabs(g->t);
      if (!(worst <= 1.0)) {
        h = s->h * (factor < SAFETY ? factor : SAFETY);
        if (hopeless) {
          give_up(g, task, s);
          h = first_step(g, task->tolerance); /* of the others: theirs need not be so short */
        }
        continue;
      }
      double part = SURFACES ? first_event(g, s, shared) : 2.0;
      if (part < 1.0) {
        double least = 4.0 * SHORTEST * (1.0 + fabs(g->t));
        s->h = part * s->h > least ? part * s->h : s->h < least ? s->h : least;
        end = g->t + s->h;
        final = end >= stop;
        if (final) end = stop;
        common_along(g->t, s->h, shared, s->c);
        if (!(try_step(g, task->tolerance, s) < INFINITY)) {
          h = MIN_FACTOR * s->h;
          continue;
        }
        factor = 1.0 / part < MAX_FACTOR ? 1.0 / part : MAX_FACTOR;
      }
      update_along(g, task, s, shared, end, stop);
      accept(g, task, s, end);
      if (part <= 1.0) {
        settle(g, s->c[STAGES], 0);
        if (!final) update_at_edge(g, task, s->c[STAGES], 0);
        if (g->t - g->rush > RUSH * (1.0 + fabs(g->t))) {
          g->rush = g->t;
          g->events = 0;
        }
        if (++g->events > MAX_RUSH) EACH_BLOCK(b) remove_lanes(g, task, b, ~(I){0}, RUN_ALONE);
      }
      /* an inner edge is shown after its jump */
      if (final) update_at_edge(g, task, s->c[STAGES], segment + 1 == task->segments);
      double tried = s->h * factor;
      h = final && tried < h ? h : tried;
    }
  }
}

/* Store totals and last states of a group that has ended. */
static void store_group(Group *g, Task *task) {
  EACH_BLOCK(b) {
    const Block *block = &g->block[b];
    for (int64_t row = g->row; row < task->points; row++)
      for (int j = 0; j < SHOWN; j++)
        *bin_place(task, g, row, j, b) = (H){0} + (uint16_t)(2 * task->bins_per_side);
    for (int l = 0; l < LANES; l++) {
      int64_t i = g->first + b * LANES + l;
      if (i >= task->count) break;
      double *total = task->totals + i, *final = task->finals + i;
      for (int j = 0; j < INTEGRALS; j++, total += task->count) *total = block->q[j][l];
      for (int j = 0; j < MEMORIES; j++, total += task->count) *total = block->m[j][l];
      for (int j = 0; j < STATES; j++, final += task->count) *final = block->x[j][l];
    }
    remove_lanes(g, task, b, ~(I){0}, FINISHED);
  }
  task->steps += g->steps;
}

/* Add the counts of this thread to those of all. */
static void add_own_counts(Task *task) {
  int64_t size = 2 * task->bins_per_side + 1;
  for (int64_t row = 0; row < task->points * SHOWN; row++) {
    struct Filled *filled = &task->filled[row];
    for (int64_t i = row * size + filled->low; i <= row * size + filled->high; i++)
      if (task->own_counts[i]) {
        __atomic_fetch_add(&task->counts[i], task->own_counts[i], __ATOMIC_RELAXED);
        task->own_counts[i] = 0;
      }
    *filled = (struct Filled){UINT16_MAX, 0};
  }
  task->members_counted = 0;
}

/* Count the bins of a batch of members. */
static void count_bins(Task *task, int64_t batch) {
  int64_t from = batch > task->begin ? batch : task->begin;
  int64_t to = batch + BATCH < task->end ? batch + BATCH : task->end;
  if (task->members_counted > UINT16_MAX - BATCH) add_own_counts(task);
  for (int64_t row = 0; row < task->points * SHOWN; row += SHOWN) {
    const uint16_t *bins = task->bins + row * PITCH - batch;
    int64_t size = 2 * task->bins_per_side + 1;
    uint16_t *counts = task->own_counts + row * size;
    for (int j = 0; j < SHOWN; j++) {
      struct Filled *filled = &task->filled[row + j];
      uint16_t low = filled->low, high = filled->high;
      for (int64_t i = from; i < to; i++) {
        low = bins[j * PITCH + i] < low ? bins[j * PITCH + i] : low;
        high = bins[j * PITCH + i] > high ? bins[j * PITCH + i] : high;
      }
      *filled = (struct Filled){low, high};
      if (row + SHOWN < task->points * SHOWN) { /* what the next time will need */
        const uint16_t *next = counts + (SHOWN + j) * size;
        for (int64_t i = filled[SHOWN].low; i <= filled[SHOWN].high; i += 32)
          __builtin_prefetch(next + i, 1);
      }
    }
    for (int64_t i = from; i < to; i++) /* in turns: the same bin twice running takes long */
      for (int j = 0; j < SHOWN; j++) counts[j * size + bins[j * PITCH + i]]++;
  }
  task->members_counted += to - from;
}

/* Integrate members until none is left: one thread of several, which take a batch at a time.
 * Returns 0, or -1 without memory. */
int integrate(Task *task) {
  void *group = NULL, *step = NULL, *marks = NULL, *bins = NULL, *filled = NULL;
  size_t points = (size_t)task->points;
  int failed = posix_memalign(&group, 64, sizeof(Group)) ||
               posix_memalign(&step, 64, sizeof(Step)) ||
               posix_memalign(&marks, 64, points * sizeof *task->grid_common) ||
               posix_memalign(&bins, 64, points * SHOWN * PITCH * sizeof *task->bins) ||
               posix_memalign(&filled, 64, points * SHOWN * sizeof *task->filled);
  if (!failed) {
    task->grid_common = marks;
    task->bins = bins;
    task->filled = filled;
    for (size_t row = 0; row < points * SHOWN; row++)
      task->filled[row] = (struct Filled){UINT16_MAX, 0};
    task->node_spacing = NODE_SPACING * pow(SPACING_TOLERANCE / task->tolerance, PER_ORDER);
    int64_t segment = 0;
    for (int64_t k = 0; k < task->points; k++) {
      while (segment + 1 < task->segments && task->grid[k] > task->edges[segment + 1]) segment++;
      common_at(task->grid[k], task->shared + segment * SHARED, task->grid_common[k]);
    }
    int64_t batch;
    while ((batch = __atomic_fetch_add(task->next_member, BATCH, __ATOMIC_RELAXED)) < task->count) {
      int64_t last = batch + BATCH < task->count ? batch + BATCH : task->count;
      for (int64_t first = batch; first < last; first += GROUP_SIZE) {
        load_group(group, task, first);
        integrate_group(task, group, step);
        store_group(group, task);
      }
      count_bins(task, batch);
    }
    add_own_counts(task);
  }
  free(group);
  free(step);
  free(marks);
  free(bins);
  free(filled);
  return failed ? -1 : 0;
}
