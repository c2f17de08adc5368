/* Single steps: DOP853 and Radau IIA, as `dop853_step` and `radau_step` in Python have them. */

static double spacing(double x) { return nextafter(fabs(x), INFINITY) - fabs(x); }

/* Call a function with the number of states of a leg first: a constant where the library serves one
   problem, so that sums over states become straight code. */
#define OF_MODE(m, function, ...)                                                                  \
    do {                                                                                           \
        if (!KNOWN_STATES)                                                                         \
            function((int)(m)->run->leg.n_y, __VA_ARGS__);                                         \
        else if ((m)->run->leg.n_y == KNOWN_STATES)                                                \
            function(KNOWN_STATES, __VA_ARGS__);                                                   \
        else                                                                                       \
            function(KNOWN_STATES + 2, __VA_ARGS__);                                               \
    } while (0)

/* The same with a constant for each usual number, where the library serves every problem. */
#define OF_SIZE(m, function, ...)                                                                  \
    do {                                                                                           \
        if (KNOWN_STATES)                                                                          \
            OF_MODE(m, function, __VA_ARGS__);                                                     \
        else                                                                                       \
            switch ((m)->run->leg.n_y) {                                                           \
                AT_SIZE(3, function, __VA_ARGS__)                                                  \
                AT_SIZE(4, function, __VA_ARGS__)                                                  \
                AT_SIZE(5, function, __VA_ARGS__)                                                  \
                AT_SIZE(6, function, __VA_ARGS__)                                                  \
                AT_SIZE(7, function, __VA_ARGS__)                                                  \
                AT_SIZE(8, function, __VA_ARGS__)                                                  \
            default:                                                                               \
                OF_MODE(m, function, __VA_ARGS__);                                                 \
            }                                                                                      \
    } while (0)
#define AT_SIZE(n, function, ...)                                                                  \
    case n:                                                                                        \
        function(n, __VA_ARGS__);                                                                  \
        break;

#ifdef __GNUC__
#define ALWAYS_INLINE static inline __attribute__((always_inline))
#else
#define ALWAYS_INLINE static inline
#endif

static void rate_at(const Machine *m, const double *y, double *rate) {
    evaluate_at(m, ZL_RATE + (int)m->run->leg.mode, y, rate);
}

/* The rates of a row of states each, whose entries belong to one of them. */
static void rates_at(const Machine *m, const double *states, double *rates) {
    zl_run *run = m->run;
    const int mode = (int)run->leg.mode, tape = ZL_RATE + mode;
    if (compiled_lanes(m->problem, tape, m->registers[tape], states, rates)) return;
    if (!m->ready->has_lanes[mode]) {
        tape_spread(&m->problem->tapes[tape], m->registers[tape], m->lanes[mode]);
        m->ready->has_lanes[mode] = 1;
    }
    tape_run_lanes(&m->problem->tapes[tape], m->lanes[mode], states, rates);
}

static void guard_at(const Machine *m, const double *y, double *pair) {
    evaluate_at(m, ZL_GUARD + (int)m->run->leg.mode, y, pair);
}

ALWAYS_INLINE void combine_slopes(const Row *row, double slopes[][ZL_MOST], int n, double *sum) {
    int i, j;
    const double *first = slopes[row->slopes[0]];
    for (i = 0; i < n; i++) sum[i] = row->weights[0] * first[i];
    for (j = 1; j < row->n; j++) {
        const double weight = row->weights[j], *slope = slopes[row->slopes[j]];
        for (i = 0; i < n; i++) sum[i] += weight * slope[i];
    }
}

ALWAYS_INLINE void explicit_state_of(const int n, const Machine *m, const double *y, double size,
                                     double slopes[][ZL_MOST], double *after) {
    double state[ZL_MOST], sum[ZL_MOST];
    int i, stage;
    for (stage = 0; stage < 11; stage++) {
        combine_slopes(&STAGES[stage], slopes, n, sum);
        for (i = 0; i < n; i++) state[i] = y[i] + size * sum[i];
        rate_at(m, state, slopes[stage + 1]);
    }
    combine_slopes(&STEP, slopes, n, sum);
    for (i = 0; i < n; i++) after[i] = y[i] + size * sum[i];
}

/* The state after a step of DOP853; the first of its slopes is there. */
static void explicit_state(const Machine *m, const double *y, double size,
                           double slopes[][ZL_MOST], double *after) {
    OF_SIZE(m, explicit_state_of, m, y, size, slopes, after);
}

static const double *weights_of(const zl_settings *settings, long long mode) {
    return mode == ZL_FLIGHT ? settings->flight_weights : settings->weights;
}

/* Infinity if a sum of states is infinite, else zero: such a step must be refused. */
ALWAYS_INLINE double overflow(const double *y, int n) {
    double total = 0.0;
    int i;
    for (i = 0; i < n; i++) total += y[i];
    return fmax(fabs(total) - DBL_MAX, 0.0);
}

ALWAYS_INLINE void explicit_step_of(const int n, const Machine *m, const double *y, double size,
                                    double slopes[][ZL_MOST], double *after, double *error) {
    const Leg *leg = &m->run->leg;
    const double *weights = weights_of(m->settings, leg->mode);
    double fifth[ZL_MOST], third[ZL_MOST], fifth_squared = 0.0, third_squared = 0.0, mixed, ratio;
    int i;
    explicit_state_of(n, m, y, size, slopes, after);
    combine_slopes(&FIFTH, slopes, n, fifth);
    combine_slopes(&THIRD, slopes, n, third);
    for (i = 0; i < n; i++) {
        double scale = leg->absolute * weights[i] +
                       leg->relative * fmax(fabs(y[i]), fabs(after[i]));
        double one = fifth[i] / scale, other = third[i] / scale;
        fifth_squared += one * one;
        third_squared += other * other;
    }
    mixed = sqrt(fifth_squared + 0.01 * third_squared);
    ratio = fmax(sqrt(fifth_squared) / (mixed + 1e-300), 0.02);
    /* A sum passes NaN on, where the larger of two may not. */
    *error = overflow(after, n) + fabs(size) * sqrt(fifth_squared / n) * (ratio + 0 * mixed);
}

/* A step of DOP853 and its error, in units of the tolerance. */
static double explicit_step(const Machine *m, const double *y, double size,
                            double slopes[][ZL_MOST], double *after) {
    double error = NAN;
    OF_SIZE(m, explicit_step_of, m, y, size, slopes, after, &error);
    return error;
}

/* A polynomial without constant term at a place, by Horner's rule. */
ALWAYS_INLINE void polynomial_at(const double *coefficients, int n, double at, double *value) {
    int i, k;
    for (i = 0; i < n; i++) value[i] = 0.0;
    for (k = ZL_STAGES - 1; k >= 0; k--)
        for (i = 0; i < n; i++) value[i] = (value[i] + coefficients[k * n + i]) * at;
}

static const double *jacobian_at(const Machine *m, const double *y, double *columns) {
    const int mode = (int)m->run->leg.mode, tape = ZL_JACOBIAN + mode;
    if (!m->ready->has_jacobian[mode]) {
        tape_prepare(&m->problem->tapes[tape], m->registers[tape], m->p);
        m->ready->has_jacobian[mode] = 1;
    }
    evaluate_at(m, tape, y, columns);
    return columns;
}

/* Triangular factors of (mu / size) I - J, inverse pivots on the diagonal, without pivoting. */
ALWAYS_INLINE void factorize(double *re, double *im, int n, const double *columns, double mu_re,
                      double mu_im, int is_complex) {
    int i, j, k;
    for (i = 0; i < n; i++)
        for (j = 0; j < n; j++) {
            re[i * n + j] = (i == j ? mu_re : 0.0) - columns[j * n + i];
            im[i * n + j] = i == j ? mu_im : 0.0;
        }
    for (k = 0; k < n; k++) {
        double *pivot_re = &re[k * n + k], *pivot_im = &im[k * n + k];
        if (is_complex) {
            double size = *pivot_re * *pivot_re + *pivot_im * *pivot_im;
            *pivot_re = *pivot_re / size;
            *pivot_im = -(*pivot_im) / size;
        } else
            *pivot_re = 1.0 / *pivot_re;
        for (i = k + 1; i < n; i++) {
            double a = re[i * n + k], b = im[i * n + k], c = a * *pivot_re, d = 0.0;
            if (is_complex) {
                c = a * *pivot_re - b * *pivot_im;
                d = a * *pivot_im + b * *pivot_re;
            }
            re[i * n + k] = c;
            if (is_complex) {
                im[i * n + k] = d;
                for (j = k + 1; j < n; j++) {
                    double e = re[k * n + j], f = im[k * n + j];
                    re[i * n + j] -= c * e - d * f;
                    im[i * n + j] -= c * f + d * e;
                }
            } else
                for (j = k + 1; j < n; j++) re[i * n + j] -= c * re[k * n + j];
        }
    }
}

ALWAYS_INLINE void solve_real(const double *re, int n, double *x) {
    int i, j;
    for (i = 0; i < n; i++)
        for (j = 0; j < i; j++) x[i] -= re[i * n + j] * x[j];
    for (i = n - 1; i >= 0; i--) {
        for (j = i + 1; j < n; j++) x[i] -= re[i * n + j] * x[j];
        x[i] *= re[i * n + i];
    }
}

ALWAYS_INLINE void subtract_product(double *x, double *z, double a, double b, double c, double d) {
    *x -= a * c - b * d;
    *z -= a * d + b * c;
}

ALWAYS_INLINE void solve_complex(const double *re, const double *im, int n, double *x, double *z) {
    int i, j;
    for (i = 0; i < n; i++)
        for (j = 0; j < i; j++)
            subtract_product(&x[i], &z[i], re[i * n + j], im[i * n + j], x[j], z[j]);
    for (i = n - 1; i >= 0; i--) {
        double a = re[i * n + i], b = im[i * n + i], c;
        for (j = i + 1; j < n; j++)
            subtract_product(&x[i], &z[i], re[i * n + j], im[i * n + j], x[j], z[j]);
        c = x[i] * a - z[i] * b;
        z[i] = x[i] * b + z[i] * a;
        x[i] = c;
    }
}

/* One implicit step: its stages, their polynomial, the state after it and the guard there. */
typedef struct {
    double stages[ZL_STAGES * ZL_MOST], coefficients[ZL_STAGES * ZL_MOST], after[ZL_MOST];
    double guard[2], error;
} Found;

ALWAYS_INLINE double norm_of(const double *change, int rows, int n, const double *scale) {
    double sum = 0.0;
    int i, k;
    for (k = 0; k < rows; k++)
        for (i = 0; i < n; i++) {
            double part = change[k * n + i] / scale[i];
            sum += part * part;
        }
    return sqrt(sum / (rows * n));
}

/* One iteration of Newton's method on the stages, and the size of its correction. */
ALWAYS_INLINE void correct(const int n, const Machine *m, const double *y, double size,
                           const double *scale, double *stages, double *norm) {
    const zl_scheme *scheme = m->problem->scheme;
    const Factors *factors = &m->run->factors;
    double residual[ZL_STAGES * ZL_MOST], change[ZL_STAGES * ZL_MOST];
    double states[ZL_MOST * ZL_LANES], rates[ZL_MOST * ZL_LANES];
    int i, j, k, pair;
    for (i = 0; i < n; i++) {
        for (k = 0; k < ZL_STAGES; k++) states[i * ZL_LANES + k] = y[i] + stages[k * n + i];
        for (; k < ZL_LANES; k++) states[i * ZL_LANES + k] = states[i * ZL_LANES];
    }
    rates_at(m, states, rates);
    for (k = 0; k < ZL_STAGES; k++) {
        double sum[ZL_MOST];
        for (i = 0; i < n; i++) sum[i] = scheme->inverse[k * ZL_STAGES] * stages[i];
        for (j = 1; j < ZL_STAGES; j++)
            for (i = 0; i < n; i++)
                sum[i] += scheme->inverse[k * ZL_STAGES + j] * stages[j * n + i];
        for (i = 0; i < n; i++)
            residual[k * n + i] = rates[i * ZL_LANES + k] - sum[i] / size;
    }
    for (pair = 0; pair < 4; pair++) {
        const double *row = scheme->rows + 2 * pair * ZL_STAGES;
        const double *column = scheme->columns + 2 * pair * ZL_STAGES;
        double real[ZL_MOST], imaginary[ZL_MOST];
        for (i = 0; i < n; i++) {
            real[i] = residual[i] * row[0];
            imaginary[i] = residual[i] * row[ZL_STAGES];
        }
        for (k = 1; k < ZL_STAGES; k++)
            for (i = 0; i < n; i++) {
                real[i] += residual[k * n + i] * row[k];
                imaginary[i] += residual[k * n + i] * row[ZL_STAGES + k];
            }
        if (pair == 0) {
            solve_real(factors->real[0], n, real);
            for (k = 0; k < ZL_STAGES; k++)
                for (i = 0; i < n; i++) change[k * n + i] = real[i] * column[k];
            continue;
        }
        solve_complex(factors->real[pair], factors->imaginary[pair], n, real, imaginary);
        for (k = 0; k < ZL_STAGES; k++)
            for (i = 0; i < n; i++) {
                change[k * n + i] += 2.0 * (real[i] * column[k]);
                change[k * n + i] -= 2.0 * (imaginary[i] * column[ZL_STAGES + k]);
            }
    }
    for (k = 0; k < ZL_STAGES * n; k++) stages[k] += change[k];
    *norm = norm_of(change, ZL_STAGES, n, scale);
}

ALWAYS_INLINE void finish_implicit(const int n, const Machine *m, const double *y, double size,
                                   const double *slope, const double *scale, Found *found) {
    const zl_scheme *scheme = m->problem->scheme;
    double raw[ZL_MOST];
    int i, j, k;
    for (k = 0; k < ZL_STAGES; k++)
        for (i = 0; i < n; i++) {
            double sum = 0.0;
            for (j = 0; j < ZL_STAGES; j++)
                sum += scheme->monomials[k * ZL_STAGES + j] * found->stages[j * n + i];
            found->coefficients[k * n + i] = sum;
        }
    for (i = 0; i < n; i++) {
        double sum = 0.0;
        for (k = 0; k < ZL_STAGES; k++) sum += found->stages[k * n + i] * scheme->embedded[k];
        raw[i] = slope[i] + sum / (scheme->gamma * size);
        found->after[i] = y[i] + found->stages[(ZL_STAGES - 1) * n + i];
    }
    solve_real(m->run->factors.real[0], n, raw);
    found->error = norm_of(raw, 1, n, scale) + overflow(found->after, n);
    guard_at(m, found->after, found->guard);
}

ALWAYS_INLINE void implicit_step_of(const int n, const Machine *m, const double *y,
                                    const double *slope, double size, const double *continued,
                                    double start, double ratio, Found *found, int *converged) {
    zl_run *run = m->run;
    const zl_scheme *scheme = m->problem->scheme;
    const double *weights = weights_of(m->settings, run->leg.mode);
    double columns[ZL_MOST * ZL_MOST], scale[ZL_MOST], last = 0.0, norm = 0.0;
    int i, k, count;
    *converged = 0;
    jacobian_at(m, y, columns);
    for (k = 0; k < 4; k++)
        factorize(run->factors.real[k], run->factors.imaginary[k], n, columns,
                  scheme->values[2 * k] / size, scheme->values[2 * k + 1] / size, k > 0);
    for (i = 0; i < n; i++)
        scale[i] = run->leg.absolute * weights[i] + run->leg.relative * fabs(y[i]);
    for (k = 0; k < ZL_STAGES * n; k++) found->stages[k] = 0.0;
    if (continued) {
        double origin[ZL_MOST];
        polynomial_at(continued, n, start, origin);
        for (k = 0; k < ZL_STAGES; k++) {
            polynomial_at(continued, n, start + ratio * scheme->nodes[k], found->stages + k * n);
            for (i = 0; i < n; i++) found->stages[k * n + i] -= origin[i];
        }
    }
    for (count = 1; count <= MOST_ITERATIONS; count++) {
        double rate;
        last = norm;
        if (KNOWN_STATES)
            correct(n, m, y, size, scale, found->stages, &norm);
        else
            OF_SIZE(m, correct, m, y, size, scale, found->stages, &norm);
        if (count < FIRST_ITERATIONS) continue;
        if (!isfinite(norm)) return;
        rate = last > 0.0 ? norm / last : 1.0;
        if (norm <= NEWTON_FLOOR || norm * rate <= NEWTON_SHARE * (1.0 - rate)) {
            finish_implicit(n, m, y, size, slope, scale, found);
            *converged = 1;
            return;
        }
        if (rate >= 2.0) return;
    }
}

/* One step of Radau IIA from a continued polynomial, if any; 0 if Newton's method fails. */
static int implicit_step(const Machine *m, const double *y, const double *slope, double size,
                         const double *continued, double start, double ratio, Found *found) {
    int converged = 0;
    OF_MODE(m, implicit_step_of, m, y, slope, size, continued, start, ratio, found, &converged);
    return converged;
}
