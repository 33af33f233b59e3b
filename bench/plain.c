/* The ensemble of floor.c as one writes it in an afternoon: Tsit5, eight members side by side in
 * loops that the compiler vectorises, sin, cos and log from the C library's vector functions.
 *
 * Every member has its own step size; eight wait for the slowest of them. Compile with
 *   gcc -O3 -march=native -mprefer-vector-width=512 -fno-math-errno -fno-trapping-math -fopenmp \
 *       -shared -fPIC -o plain.so plain.c -lmvec -lm
 */
#define VECTORISED __attribute__((simd("notinbranch")))
VECTORISED double sin(double);
VECTORISED double cos(double);
VECTORISED double log(double);
VECTORISED double pow(double, double);
#define sqrt __builtin_sqrt
#define fabs __builtin_fabs
#define fmin(a, b) ((a) < (b) ? (a) : (b))
#define fmax(a, b) ((a) > (b) ? (a) : (b))

enum { LANES = 8, N = 4, STAGES = 7 };

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
static const double SAFETY = 0.9, SHRINK = 0.2, GROW = 5, TINY = 1e-13;

typedef double Lanes[LANES] __attribute__((aligned(64)));

static void rates(const Lanes t, const Lanes gain, const Lanes theta, Lanes y[N], Lanes f[N])
{
    Lanes sines, cosines; /* in loops of their own: there is no vector sincos */
#pragma omp simd
    for (int l = 0; l < LANES; l++)
        sines[l] = sin(t[l]);
#pragma omp simd
    for (int l = 0; l < LANES; l++)
        cosines[l] = cos(t[l]);
#pragma omp simd
    for (int l = 0; l < LANES; l++) {
        double x1 = y[0][l], x2 = y[1][l], delta_hat = y[2][l], theta_hat = y[3][l];
        double sin_t = sines[l], cos_t = cosines[l];
        double square = x1 * x1 + x2 * x2;
        double drift = x1 * x1 * x2, phi = 1 + x1 * sin(x2);
        double e2 = 1.75 * x1 + x2 - 0.65 * cos_t;
        double ubar = 0.16015625 * x1 - 5.265625 * x2 + 1.54765625 * cos_t - 0.65 * sin_t
                      - theta_hat * phi - drift;
        f[0][l] = -3 * x1 + 2 * x2 + 0.1 * sqrt(square) * sin_t * cos_t;
        f[1][l] = drift + gain[l] * delta_hat * ubar + theta[l] * phi + 0.04 * log(1 + square)
                  + 0.02 / (1 + t[l]);
        f[2][l] = -0.6 * (delta_hat - 0.4) - e2 * ubar;
        f[3][l] = phi * e2 - 0.6 * (theta_hat - 2.1);
    }
}

/* Members first ... first + 7; returns how many did not arrive. */
static int integrate_lanes(int members, const double *x0, const double *gains,
                           const double *thetas, double tol, double t_end, int first,
                           double *final)
{
    Lanes y[N], new[N], k[STAGES][N], t, h, at, gain, theta, err2;
    for (int l = 0; l < LANES; l++) {
        int i = first + l < members ? first + l : members - 1;
        for (int d = 0; d < N; d++)
            y[d][l] = x0[d * members + i];
        gain[l] = gains[i];
        theta[l] = thetas[i];
        t[l] = 0;
    }
    rates(t, gain, theta, y, k[0]);
    for (int l = 0; l < LANES; l++) {
        double speed = 1;
        for (int d = 0; d < N; d++)
            speed += fabs(k[0][d][l]) / (1 + fabs(y[d][l]));
        h[l] = pow(tol, 0.2) / speed;
    }
    for (int running = 1; running;) {
        for (int i = 1; i < STAGES; i++) {
            for (int l = 0; l < LANES; l++)
                at[l] = t[l] + C[i] * h[l];
            for (int d = 0; d < N; d++)
                for (int l = 0; l < LANES; l++) {
                    double sum = 0;
#pragma GCC unroll 8
                    for (int j = 0; j < i; j++)
                        sum += A[i][j] * k[j][d][l];
                    new[d][l] = y[d][l] + h[l] * sum;
                }
            rates(at, gain, theta, new, k[i]);
        }
        for (int l = 0; l < LANES; l++) {
            double sum = 0;
            for (int d = 0; d < N; d++) {
                double e = 0;
#pragma GCC unroll 8
                for (int j = 0; j < STAGES; j++)
                    e += E[j] * k[j][d][l];
                e *= h[l] / (tol * (1 + fmax(fabs(y[d][l]), fabs(new[d][l]))));
                sum += e * e;
            }
            err2[l] = sum / N + 1e-20;
        }
        running = 0;
#pragma omp simd reduction(| : running)
        for (int l = 0; l < LANES; l++) {
            int ok = err2[l] <= 1;
            double factor = SAFETY * pow(err2[l], -0.1);
            factor = fmin(fmax(factor, SHRINK), GROW);
            t[l] = ok ? t[l] + h[l] : t[l];
            for (int d = 0; d < N; d++) {
                y[d][l] = ok ? new[d][l] : y[d][l];
                k[0][d][l] = ok ? k[STAGES - 1][d][l] : k[0][d][l];
            }
            h[l] = fmin(h[l] * factor, t_end - t[l]);
            running |= h[l] > TINY;
        }
    }
    int failed = 0;
    for (int l = 0; l < LANES && first + l < members; l++) {
        failed += t_end - t[l] > TINY;
        for (int d = 0; d < N; d++)
            final[d * members + first + l] = y[d][l];
    }
    return failed;
}

int integrate(int members, const double *x0, const double *gain, const double *theta, double tol,
              double t_end, int threads, double *final)
{
    int failed = 0;
#pragma omp parallel for num_threads(threads) schedule(dynamic) reduction(+ : failed)
    for (int first = 0; first < members; first += LANES)
        failed += integrate_lanes(members, x0, gain, theta, tol, t_end, first, final);
    return failed;
}
