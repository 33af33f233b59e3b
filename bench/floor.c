/* Ensemble of one adaptive closed loop, integrated as fast as the hardware allows.
 *
 * Tsit5 (5(4) pair, first same as last). Every member has its own step size. Members advance side
 * by side in SIMD lanes, and a lane that finishes takes the next member at once, so lanes idle
 * only at the very end of the ensemble. Threads draw members from one shared counter.
 *
 *   gcc -O3 -march=native -fschedule-insns -fopenmp -Wno-psabi -shared -fPIC -o floor.so floor.c
 */
#include <stdint.h>
#include <string.h>
#ifdef __AVX512DQ__
#include <immintrin.h>
enum { LANES = 8 };
#else
enum { LANES = 4 };
#endif

#define WIDE 4 /* blocks of lanes per thread: the work of one hides the latency of another */

enum { N = 4, STAGES = 7 };

typedef double Real __attribute__((vector_size(8 * LANES)));
typedef int64_t Int __attribute__((vector_size(8 * LANES)));

#define INLINE static inline __attribute__((always_inline))

static const double A[STAGES][STAGES - 1] = {
    {0},
    {0.161},
    {-0.008480655492356989, 0.335480655492357},
    {2.8971530571054935, -6.359448489975075, 4.3622954328695815},
    {5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525},
    {5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401,
     -0.028269050394068383},
    {0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081,
     2.324710524099774},
};
static const double C[STAGES] = {0, 0.161, 0.327, 0.9, 0.9800255409045097, 1, 1};
static const double E[STAGES] = {
    -0.00178001105222577714, -0.0008164344596567469, 0.007880878010261995, -0.1447110071732629,
    0.5823571654525552,      -0.45808210592918697,   1.0 / 66};

/* Step-size control: h *= SAFETY err^(-1/5) within [SHRINK, GROW]. */
static const double SAFETY = 0.9, SHRINK = 0.2, GROW = 5;

static const double H_MAX = 0.5;  /* the series in `advance_clock` are exact to rounding up to it */
static const double TINY = 1e-13; /* a step no longer than this ends the integration */

/* 1 / c and log c at the centres c of 16 equal parts of [1, 2]. */
#define PARTS(F) F(1) F(3) F(5) F(7) F(9) F(11) F(13) F(15) F(17) F(19) F(21) F(23) F(25) F(27) \
    F(29) F(31)
#define ONE_INVERSE(i) 32.0 / (32 + i),
#define ONE_LOG(i) __builtin_log((32.0 + i) / 32),
static const double INVERSE[16] = {PARTS(ONE_INVERSE)}, LOG[16] = {PARTS(ONE_LOG)};

/* ---- elementary functions, on all lanes ---------------------------------------------------- */

INLINE Real fill(double x) { return x - (Real){0}; }
INLINE Real choose(Int mask, Real a, Real b) { return (Real)((mask & (Int)a) | (~mask & (Int)b)); }

#ifdef __AVX512DQ__
INLINE Real smaller(Real a, Real b) { return _mm512_min_pd(a, b); } /* b if a is not a number */
INLINE Real larger(Real a, Real b) { return _mm512_max_pd(a, b); }
INLINE Real size(Real a) { return _mm512_abs_pd(a); }
INLINE int any(Int mask) { return _mm512_movepi64_mask((__m512i)mask) != 0; }
INLINE Real rough_reciprocal(Real x) { return _mm512_rcp14_pd(x); }
INLINE Real lookup(const double table[16], Int index) /* of the index, 4 bits count */
{
    return _mm512_permutex2var_pd(_mm512_loadu_pd(table), (__m512i)index,
                                  _mm512_loadu_pd(table + 8));
}

/* Divider and square root are hardly pipelined: start from 14 bits and refine. */
INLINE Real reciprocal(Real x)
{
    Real y = _mm512_rcp14_pd(x), e = 1 - x * y;
    y += y * e;
    return y + y * (e * e);
}

INLINE Real root(Real x)
{
    Real y = _mm512_rsqrt14_pd(x + 1e-300); /* finite at x = 0 */
    Real r = x * y, e = 1 - r * y;
    return r + (r * e) * (0.5 + e * (0.375 + e * 0.3125));
}
#else
INLINE Real smaller(Real a, Real b) { return choose(a < b, a, b); }
INLINE Real larger(Real a, Real b) { return choose(a > b, a, b); }
INLINE Real size(Real a) { return (Real)((Int)a & INT64_MAX); }
INLINE Real reciprocal(Real x) { return 1 / x; }
INLINE Real rough_reciprocal(Real x) { return 1 / x; }
INLINE Real root(Real x)
{
    for (int l = 0; l < LANES; l++)
        x[l] = __builtin_sqrt(x[l]);
    return x;
}
INLINE Real lookup(const double table[16], Int index)
{
    Real values;
    for (int l = 0; l < LANES; l++)
        values[l] = table[index[l] & 15];
    return values;
}
INLINE int any(Int mask)
{
    int64_t bits = 0;
    for (int l = 0; l < LANES; l++)
        bits |= mask[l];
    return bits != 0;
}
#endif

/* sin x, error 2e-16 (1 + |x|): the angle is reduced by multiples of the rounded pi. */
INLINE Real sine(Real x)
{
    const double magic = 6755399441055744.0; /* 1.5 * 2^52: adding it rounds to an integer */
    Real shifted = x * 0.31830988618379067 + magic, k = shifted - magic;
    Real r = x - k * 3.141592653589793;
    Real z = r * r, z2 = z * z;
    Real p0 = z * 0.0083333333333259309 - 0.16666666666666648; /* short chains, not Horner's */
    Real p1 = z * 2.7557318055499585e-6 - 0.00019841269836468067;
    Real p2 = z * 1.605097160362982e-10 - 2.5051972905379012e-8;
    Real p = p0 + z2 * (p1 + z2 * (p2 - 7.4080454517479943e-13 * z2));
    return (Real)((Int)(r + (r * z) * p) ^ ((Int)shifted << 63));
}

/* log x for normal x > 0, absolute error 1e-15: x = 2^k m and m = centre_i (1 + r), |r| < 1/32. */
INLINE Real logarithm(Real x)
{
    const int64_t one = 0x3ff0000000000000, fraction = 0x000fffffffffffff;
    Int bits = (Int)x, index = bits >> 48;
    Real m = (Real)((bits & fraction) | one);
    Real k = __builtin_convertvector((bits - one) >> 52, Real);
    Real r = m * lookup(INVERSE, index) - 1, z = r * r;
    Real p = r * 0.14302004969935271 - 0.16684993320145907;
    Real q = r * 0.19999994032650117 - 0.24999993286903622;
    Real s = r * 0.33333333333657097 - 0.50000000000364225;
    return (k * 0.69314718055994531 + (lookup(LOG, index) + r)) + z * (s + z * (q + z * p));
}

/* x^a to a few percent, which is all that step-size control needs: the bits of a double are
 * nearly its logarithm. */
INLINE Real rough_power(Real x, double a)
{
    const double one = 4607182418800017408.0; /* the bits of 1.0 */
    Real bits = __builtin_convertvector((Int)x, Real);
    return (Real)__builtin_convertvector(bits * a + one * (1 - a), Int);
}

/* ---- model --------------------------------------------------------------------------------- */

typedef struct {
    Real sin_t, cos_t, decay; /* decay = 1 / (1 + t) */
} Clock;

/* The clock at t + c h, given the one at t: no range reduction, as c h is small. */
INLINE Clock advance_clock(Clock now, Real t, Real h, double c)
{
    Real x = c * h, z = x * x;
    Real p = z * (1 / 6227020800.0) - 1 / 39916800.0;
    Real q = z * (1 / 479001600.0) - 1 / 3628800.0;
    p = p * z + 1 / 362880.0;
    q = q * z + 1 / 40320.0;
    p = p * z - 1 / 5040.0;
    q = q * z - 1 / 720.0;
    p = p * z + 1 / 120.0;
    q = q * z + 1 / 24.0;
    p = p * z - 1 / 6.0;
    q = q * z - 1 / 2.0;
    Real s = x + (x * z) * p, v = z * q; /* sin x and cos x - 1 */
    return (Clock){now.sin_t + (now.sin_t * v + now.cos_t * s),
                   now.cos_t + (now.cos_t * v - now.sin_t * s), reciprocal((t + 1) + x)};
}

INLINE void rates(Clock now, Real gain, Real theta, const Real y[N], Real f[N])
{
    Real x1 = y[0], x2 = y[1], delta_hat = y[2], theta_hat = y[3];
    Real square = x1 * x1 + x2 * x2;
    Real drift = x1 * x1 * x2, phi = x1 * sine(x2) + 1;
    Real e2 = 1.75 * x1 + x2 - 0.65 * now.cos_t;
    Real ubar = (1.54765625 * now.cos_t - 0.65 * now.sin_t) + 0.16015625 * x1 - 5.265625 * x2
                - drift - theta_hat * phi;
    f[0] = 2 * x2 - 3 * x1 + (0.1 * now.sin_t * now.cos_t) * root(square);
    f[1] = drift + 0.02 * now.decay + theta * phi + (gain * delta_hat) * ubar
           + 0.04 * logarithm(square + 1); /* the logarithm takes longest */
    f[2] = 0.24 - 0.6 * delta_hat - e2 * ubar;
    f[3] = phi * e2 + (1.26 - 0.6 * theta_hat);
}

/* ---- integrator ---------------------------------------------------------------------------- */

typedef struct {
    int members;
    const double *x0, *gain, *theta;
    double tol, t_end;
    double *final;
    int next, failed;
} Ensemble;

typedef struct {
    Real y[N], y_new[N], k[STAGES][N], gain, theta;
    Clock now, then; /* at the beginning and at the end of the step */
    Real h, left;
    Int idle;
    int member[LANES];
} Block;

/* Give the lane the next member. Returns 0 if none is left: the lane then stands still. */
static int refill(Block *b, Ensemble *all, int lane)
{
    int i, n = all->members;
#pragma omp atomic capture
    i = all->next++;
    if (i >= n) {
        b->idle[lane] = -1;
        b->h[lane] = 0;
        return 0;
    }
    Real y[N], f[N];
    Clock start = {fill(0), fill(1), fill(1)};
    double speed = 1;
    for (int d = 0; d < N; d++)
        y[d] = fill(all->x0[d * n + i]);
    rates(start, fill(all->gain[i]), fill(all->theta[i]), y, f);
    for (int d = 0; d < N; d++) {
        double rate = f[d][0] / (1 + __builtin_fabs(y[d][0]));
        speed += __builtin_fabs(rate);
        b->y[d][lane] = y[d][0];
        b->k[0][d][lane] = f[d][0];
    }
    b->member[lane] = i;
    b->gain[lane] = all->gain[i];
    b->theta[lane] = all->theta[i];
    b->now.sin_t[lane] = 0;
    b->now.cos_t[lane] = 1;
    b->left[lane] = all->t_end;
    /* the right order of magnitude is enough */
    Real h = smaller(rough_power(fill(all->tol), 0.2) / speed, fill(all->t_end));
    b->h[lane] = smaller(h, fill(H_MAX))[0];
    return 1;
}

INLINE void stage(Block *b, int i, double t_end)
{
    Real y[N];
    for (int d = 0; d < N; d++) {
        Real sum = A[i][0] * b->k[0][d];
#pragma GCC unroll 8
        for (int j = 1; j < i; j++)
            sum += A[i][j] * b->k[j][d];
        y[d] = b->y[d] + b->h * sum;
    }
    /* the last two stages are both at t + h */
    Clock clock = i == STAGES - 1 ? b->then : advance_clock(b->now, t_end - b->left, b->h, C[i]);
    if (i == STAGES - 2)
        b->then = clock;
    if (i == STAGES - 1)
        memcpy(b->y_new, y, sizeof y);
    rates(clock, b->gain, b->theta, y, b->k[i]);
}

/* Accept or reject every lane's step and choose the next one. Returns which lanes are done. */
INLINE Int decide(Block *b, double tol)
{
    Real sum = fill(0);
    for (int d = 0; d < N; d++) {
        Real e = E[0] * b->k[0][d];
#pragma GCC unroll 8
        for (int j = 1; j < STAGES; j++)
            e += E[j] * b->k[j][d];
        e *= rough_reciprocal(larger(size(b->y[d]), size(b->y_new[d])) + 1);
        sum += e * e;
    }
    Real err2 = (b->h * b->h) * sum * (1 / (N * tol * tol)) + 1e-20;
    err2 = smaller(err2, fill(1e300)); /* not a number: reject, until the step vanishes */
    Int ok = err2 <= 1;
    Real factor = SAFETY * rough_power(err2, -0.1);
    factor = smaller(larger(factor, fill(SHRINK)), choose(ok, fill(GROW), fill(1)));
    b->left = choose(ok, b->left - b->h, b->left);
    b->h = smaller(smaller(b->h * factor, fill(H_MAX)), b->left);
    b->now.sin_t = choose(ok, b->then.sin_t, b->now.sin_t);
    b->now.cos_t = choose(ok, b->then.cos_t, b->now.cos_t);
    for (int d = 0; d < N; d++) {
        b->y[d] = choose(ok, b->y_new[d], b->y[d]);
        b->k[0][d] = choose(ok, b->k[STAGES - 1][d], b->k[0][d]);
    }
    return (b->h <= TINY) & ~b->idle;
}

static void replace_done(Block *b, Ensemble *all, Int done, int *running)
{
    for (int l = 0; l < LANES; l++)
        if (done[l]) {
            for (int d = 0; d < N; d++)
                all->final[d * all->members + b->member[l]] = b->y[d][l];
            if (b->left[l] > TINY) {
#pragma omp atomic
                all->failed++;
            }
            *running -= !refill(b, all, l);
        }
}

/* Integrate members until none is left, `width` blocks at a time. */
INLINE void run_group(Ensemble *all, int width)
{
    Block group[WIDE];
    int running = 0;
    memset(group, 0, sizeof group);
    for (int l = 0; l < LANES; l++) /* spread few members over the blocks */
        for (int b = 0; b < width; b++)
            running += refill(&group[b], all, l);
    while (running) {
#pragma GCC unroll 8
        for (int i = 1; i < STAGES; i++)
#pragma GCC unroll 1
            for (int b = 0; b < width; b++)
                stage(&group[b], i, all->t_end);
#pragma GCC unroll 1
        for (int b = 0; b < width; b++) {
            Int done = decide(&group[b], all->tol);
            if (__builtin_expect(any(done), 0))
                replace_done(&group[b], all, done, &running);
        }
    }
}

/* Final states of all members; arrays of states are 4 x members. Returns how many members did not
 * arrive because their step size vanished (their last state is given). */
int integrate(int members, const double *x0, const double *gain, const double *theta, double tol,
              double t_end, int threads, double *final)
{
    Ensemble all = {members, x0, gain, theta, tol, t_end, final, 0, 0};
#pragma omp parallel num_threads(threads) if (threads > 1)
    {
        if (members < 8 * WIDE * LANES * threads) /* few: lanes idling at the end would cost more */
            run_group(&all, 1);
        else
            run_group(&all, WIDE);
    }
    return all.failed;
}

/* Rates of one member, to check the model. */
void right_hand_side(double t, const double *y, double gain, double theta, double *f)
{
    Clock clock = {fill(0), fill(1), fill(1)};
    Real in[N], out[N];
    for (double h = H_MAX, at = 0; at < t; at += h) { /* as the integrator goes there: by steps */
        h = h < t - at ? h : t - at;
        clock = advance_clock(clock, fill(at), fill(h), 1);
    }
    for (int d = 0; d < N; d++)
        in[d] = fill(y[d]);
    rates(clock, fill(gain), fill(theta), in, out);
    for (int d = 0; d < N; d++)
        f[d] = out[d][0];
}
