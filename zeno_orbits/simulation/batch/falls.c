/* Falls of the guards of many lanes inside their steps, by `fall.c`: `events` of this folder in C. */

typedef int (*Kernel)(const double **, double **, long long *, double *, int);

typedef struct {
    Curve curve;
    Kernel step;
    const double *y, *p;
    double tolerance, *after;
} LaneStep;

/* The guard at the end of a true, shorter step from the same start. */
static void shorter_step(const Curve *curve, int kind, double offset, double *pair) {
    const LaneStep *lane = (const LaneStep *)curve;
    double numbers[2] = {offset, lane->tolerance}, error;
    const double *given[3] = {lane->y, lane->p, numbers};
    double *taken[3] = {lane->after, &error, pair};
    lane->step(given, taken, 0, 0, 0);
}

/* Each row of `numbers` is size, tolerance, 1 on the guard, then guard and rate at start and end. */
CASADI_SYMBOL_EXPORT void zk_falls(Kernel step, long long n, long long n_y, long long n_p,
                                   const double *y, const double *p, const double *numbers,
                                   double *scratch, double *falls) {
    long long k;
    for (k = 0; k < n; k++) {
        const double *own = numbers + 7 * k;
        LaneStep lane = {{shorter_step, own[0], 1}, step, y + k * n_y, p + k * n_p, own[1], scratch};
        falls[k] = first_fall(&lane.curve, own + 3, own + 5, own[2] != 0.0);
    }
}
