/* Follow a flow until its guard falls: the loop of `automatic`, `dop853` and `radau` in C.

   It stands after `fall.c` and the kernels of one mode (`zk_rate`, `zk_guard`, `zk_jacobian`, `zk_step`,
   `zk_begin`, `zk_correct`, `zk_error`), whose sizes and numbers stand before it:
   N_Y states, N_S stages, N_FACTORS entries of Newton's matrices, MONOMIALS of the scheme, and the
   numbers of the step control. The Python loop is the reference; a test holds both together. */

enum { FALL, HORIZON, LEFT, FULL, FAR, EXPLICIT_SINGULAR, IMPLICIT_SINGULAR, NOT_FINITE, RATES };

typedef struct {
    double horizon, relative, absolute, rounding, largest_explicit, largest_implicit;
    double time, size, last_size, earlier_size, fastest, first, largest_change, offset;
    double guard[2], y[N_Y], end[N_Y], reach[N_Y], eigenvalues[2 * N_Y], coefficients[N_S * N_Y];
    long long switches, implicit, on_guard, started, refused, has_last, has_rates, n_steps;
    long long n_explicit, n_recorded, n_polynomials, capacity;
    const double *p;
    double *rows, *polynomials;
} Leg;

typedef struct {
    Curve curve;
    const Leg *leg;
    const double *before, *after, *guard_after;
    const double *coefficients; /* of an implicit step, else null */
    double *ended; /* where the last implicit step from its start ended, and the state there */
} Step;

typedef struct {
    double factors[N_FACTORS], stages[N_S * N_Y], coefficients[N_S * N_Y], after[N_Y], told[5];
} Found;

static double spacing(double x) { return nextafter(fabs(x), INFINITY) - fabs(x); }

static void rate_at(const Leg *leg, const double *y, double *rate) {
    const double *given[2] = {y, leg->p};
    double *taken[1] = {rate};
    zk_rate(given, taken, 0, 0, 0);
}

static void guard_at(const Leg *leg, const double *y, double *pair) {
    const double *given[2] = {y, leg->p};
    double *taken[1] = {pair};
    zk_guard(given, taken, 0, 0, 0);
}

/* One step of DOP853; `told` is the error, then the guard and its rate at the end. */
static void explicit_step(const Leg *leg, const double *y, double size, double *after,
                          double *told) {
    double numbers[3] = {size, leg->relative, leg->absolute};
    const double *given[3] = {y, leg->p, numbers};
    double *taken[3] = {after, told, told + 1};
    zk_step(given, taken, 0, 0, 0);
}

/* One step of Radau IIA from a continued polynomial, if any; 0 if Newton's method fails. */
static int implicit_step(const Leg *leg, const double *y, double size, const double *continued,
                         double start, double ratio, Found *found) {
    static const double nothing[N_S * N_Y] = {0.0};
    double numbers[5] = {size, leg->relative, leg->absolute, start, ratio}, norm, last;
    const double *given[4] = {y, leg->p, numbers, continued ? continued : nothing};
    double *taken[5] = {found->factors, found->stages, found->coefficients, found->after,
                        found->told};
    int count, i, k, j;
    zk_begin(given, taken, 0, 0, 0);
    last = found->told[0];
    norm = found->told[1];
    for (count = FIRST_ITERATIONS; count <= MOST_ITERATIONS; count++) {
        const double *iterate[5] = {y, leg->p, numbers, found->factors, found->stages};
        double rate;
        if (!isfinite(norm)) return 0;
        rate = last > 0.0 ? norm / last : 1.0;
        if (norm <= NEWTON_FLOOR || norm * rate <= NEWTON_SHARE * (1.0 - rate)) {
            double *error[1] = {found->told + 2};
            if (count == FIRST_ITERATIONS) return 1;
            for (k = 0; k < N_S; k++)
                for (i = 0; i < N_Y; i++) {
                    double sum = 0.0;
                    for (j = 0; j < N_S; j++)
                        sum += MONOMIALS[k * N_S + j] * found->stages[j * N_Y + i];
                    found->coefficients[k * N_Y + i] = sum;
                }
            for (i = 0; i < N_Y; i++) found->after[i] = y[i] + found->stages[(N_S - 1) * N_Y + i];
            zk_error(iterate, error, 0, 0, 0);
            guard_at(leg, found->after, found->told + 3);
            return 1;
        }
        if (rate >= 2.0) return 0;
        last = norm;
        {
            double corrected[N_S * N_Y];
            double *next[2] = {corrected, &norm};
            zk_correct(iterate, next, 0, 0, 0);
            memcpy(found->stages, corrected, sizeof corrected);
        }
    }
    return 0;
}

/* The state inside a step as dense output has it, and the guard there. */
static void dense(const Step *step, double offset, double *state, double *pair) {
    int i, k;
    if (offset == step->curve.size) {
        memcpy(state, step->after, N_Y * sizeof(double));
        pair[0] = step->guard_after[0];
        pair[1] = step->guard_after[1];
        return;
    }
    if (!step->coefficients) {
        double told[3];
        explicit_step(step->leg, step->before, offset, state, told);
        pair[0] = told[1];
        pair[1] = told[2];
        return;
    }
    for (i = 0; i < N_Y; i++) {
        double value = 0.0, at = offset / step->curve.size;
        for (k = N_S - 1; k >= 0; k--) value = (value + step->coefficients[k * N_Y + i]) * at;
        state[i] = step->before[i] + value;
    }
    guard_at(step->leg, state, pair);
}

/* The same after a true step that ends inside a step; dense output where there is none. */
static void true_end(const Step *step, double offset, double *state, double *pair) {
    Found found;
    if (step->coefficients && 0.0 < offset && offset < step->curve.size &&
        implicit_step(step->leg, step->before, offset, step->coefficients, 0.0,
                      offset / step->curve.size, &found)) {
        memcpy(state, found.after, sizeof found.after);
        pair[0] = found.told[3];
        pair[1] = found.told[4];
        step->ended[0] = offset;
        memcpy(step->ended + 1, found.after, sizeof found.after);
        return;
    }
    dense(step, offset, state, pair);
}

/* The state at the end of a leg. From so near a true end a tangent is right to rounding. */
static void leg_end(const Step *step, double offset, double *state) {
    double shift = offset - step->ended[0], slope[N_Y], pair[2];
    int i;
    if (!(fabs(shift) <= DOUBLES * step->curve.size)) {
        true_end(step, offset, state, pair);
        return;
    }
    rate_at(step->leg, step->ended + 1, slope);
    for (i = 0; i < N_Y; i++) state[i] = step->ended[1 + i] + shift * slope[i];
}

/* Whether the guard, from its root at the start of the leg, has not risen above rounding. */
static int is_rounding(const Step *step, double fall) {
    double state[N_Y], pair[2];
    leg_end(step, fall, state);
    guard_at(step->leg, state, pair);
    return fabs(pair[1]) * (step->leg->time + fall) < step->leg->rounding;
}

/* The guard inside a step, as `fall.c` asks for it. */
static void look_inside(const Curve *curve, int kind, double offset, double *pair) {
    double state[N_Y];
    (kind == TRUE_END ? true_end : dense)((const Step *)curve, offset, state, pair);
}

/* Eigenvalues of a real matrix by rows, destroyed; real parts, then imaginary. 0 if none came.
   Elimination to Hessenberg form, then Francis' double steps [GolubVanLoan, 7.5]. */
static int eigenvalues(double a[N_Y][N_Y], double *real, double *imaginary) {
    int i, j, k, m, last = N_Y - 1, count = 0;
    double norm = 0.0, shift = 0.0;
    for (m = 1; m < N_Y - 1; m++) {
        double largest = 0.0;
        int pivot = m;
        for (i = m; i < N_Y; i++)
            if (fabs(a[i][m - 1]) > fabs(largest)) {
                largest = a[i][m - 1];
                pivot = i;
            }
        if (largest == 0.0) continue;
        if (pivot != m) {
            for (j = m - 1; j < N_Y; j++) {
                double kept = a[pivot][j];
                a[pivot][j] = a[m][j];
                a[m][j] = kept;
            }
            for (j = 0; j < N_Y; j++) {
                double kept = a[j][pivot];
                a[j][pivot] = a[j][m];
                a[j][m] = kept;
            }
        }
        for (i = m + 1; i < N_Y; i++) {
            double factor = a[i][m - 1] / largest;
            if (factor == 0.0) continue;
            a[i][m - 1] = 0.0;
            for (j = m; j < N_Y; j++) a[i][j] -= factor * a[m][j];
            for (j = 0; j < N_Y; j++) a[j][m] += factor * a[j][i];
        }
    }
    for (i = 0; i < N_Y; i++)
        for (j = i > 0 ? i - 1 : 0; j < N_Y; j++) norm += fabs(a[i][j]);
    if (norm == 0.0) norm = 1.0;
    while (last >= 0) {
        double x, y, w, p = 0.0, q = 0.0, r = 0.0;
        int low;
        for (low = last; low > 0; low--) {
            double size = fabs(a[low - 1][low - 1]) + fabs(a[low][low]);
            if (size == 0.0) size = norm;
            if (fabs(a[low][low - 1]) <= DBL_EPSILON * size) {
                a[low][low - 1] = 0.0;
                break;
            }
        }
        x = a[last][last];
        if (low == last) {
            real[last] = x + shift;
            imaginary[last] = 0.0;
            last--;
            count = 0;
            continue;
        }
        y = a[last - 1][last - 1];
        w = a[last][last - 1] * a[last - 1][last];
        if (low == last - 1) {
            double half = (y - x) / 2, square = half * half + w, z = sqrt(fabs(square));
            x += shift;
            if (square >= 0.0) {
                z = half + (half >= 0.0 ? z : -z);
                real[last - 1] = x + z;
                real[last] = z != 0.0 ? x - w / z : x + z;
                imaginary[last - 1] = imaginary[last] = 0.0;
            } else {
                real[last - 1] = real[last] = x + half;
                imaginary[last - 1] = z;
                imaginary[last] = -z;
            }
            last -= 2;
            count = 0;
            continue;
        }
        if (++count > 60) return 0;
        if (count % 10 == 0) {
            double size = fabs(a[last][last - 1]) + fabs(a[last - 1][last - 2]);
            shift += x;
            for (i = 0; i <= last; i++) a[i][i] -= x;
            x = y = 0.75 * size;
            w = -0.4375 * size * size;
        }
        for (m = last - 2; m >= low; m--) {
            double z = a[m][m], right = x - z, left = y - z, size;
            p = (right * left - w) / a[m + 1][m] + a[m][m + 1];
            q = a[m + 1][m + 1] - z - right - left;
            r = a[m + 2][m + 1];
            size = fabs(p) + fabs(q) + fabs(r);
            p /= size;
            q /= size;
            r /= size;
            if (m == low) break;
            if (fabs(a[m][m - 1]) * (fabs(q) + fabs(r)) <=
                DBL_EPSILON * fabs(p) *
                    (fabs(a[m - 1][m - 1]) + fabs(z) + fabs(a[m + 1][m + 1])))
                break;
        }
        for (i = m + 2; i <= last; i++) {
            a[i][i - 2] = 0.0;
            if (i > m + 2) a[i][i - 3] = 0.0;
        }
        for (k = m; k < last; k++) {
            int three = k < last - 1;
            double length, size = 1.0, u, v, t;
            if (k > m) {
                p = a[k][k - 1];
                q = a[k + 1][k - 1];
                r = three ? a[k + 2][k - 1] : 0.0;
                size = fabs(p) + fabs(q) + fabs(r);
                if (size == 0.0) continue;
                p /= size;
                q /= size;
                r /= size;
            }
            length = sqrt(p * p + q * q + r * r);
            if (p < 0.0) length = -length;
            if (length == 0.0) continue;
            if (k > m)
                a[k][k - 1] = -length * size;
            else if (low != m)
                a[k][k - 1] = -a[k][k - 1];
            p += length;
            t = p / length;
            u = q / length;
            v = r / length;
            q /= p;
            r /= p;
            for (j = k; j <= last; j++) {
                double sum = a[k][j] + q * a[k + 1][j];
                if (three) {
                    sum += r * a[k + 2][j];
                    a[k + 2][j] -= sum * v;
                }
                a[k + 1][j] -= sum * u;
                a[k][j] -= sum * t;
            }
            for (i = low; i <= (last < k + 3 ? last : k + 3); i++) {
                double sum = t * a[i][k] + u * a[i][k + 1];
                if (three) {
                    sum += v * a[i][k + 2];
                    a[i][k + 2] -= sum * r;
                }
                a[i][k + 1] -= sum * q;
                a[i][k] -= sum;
            }
        }
    }
    return 1;
}

/* The largest rate of what does not decay long before a leg ends. */
static double staying_rate(const Leg *leg, double left) {
    double largest = 0.0;
    int i;
    for (i = 0; i < N_Y; i++) {
        double real = leg->eigenvalues[i], imaginary = leg->eigenvalues[N_Y + i];
        if (!(real < -fabs(imaginary) && -real * left > LONG_LEFT))
            largest = greater(largest, hypot(real, imaginary));
    }
    return largest;
}

/* What holds explicit steps back, from the eigenvalues. */
static void set_limits(Leg *leg) {
    double fastest = 0.0, next = 0.0, lowest = leg->eigenvalues[0];
    int i;
    for (i = 1; i < N_Y; i++) lowest = lesser(lowest, leg->eigenvalues[i]);
    fastest = greater(-lowest, 0.0);
    for (i = 0; i < N_Y; i++)
        if (-leg->eigenvalues[i] < fastest / 10)
            next = greater(next, hypot(leg->eigenvalues[i], leg->eigenvalues[N_Y + i]));
    leg->fastest = leg->first = 0.0;
    if (!(fastest > PAYS * staying_rate(leg, INFINITY))) return;
    leg->fastest = fastest;
    if (next > 0.0) leg->first = FIRST_STEP * pow(leg->relative, 1.0 / 8.0) / next;
}

/* Look at the rates of a flow; 0 if the caller has to give the eigenvalues. */
static int look(Leg *leg, const double *y) {
    double columns[N_Y * N_Y], rows[N_Y][N_Y];
    const double *given[2] = {y, leg->p};
    double *taken[1] = {columns};
    int i, j;
    zk_jacobian(given, taken, 0, 0, 0);
    for (i = 0; i < N_Y; i++)
        for (j = 0; j < N_Y; j++) {
            rows[i][j] = columns[j * N_Y + i];
            if (!isfinite(rows[i][j])) return 0;
        }
    if (!eigenvalues(rows, leg->eigenvalues, leg->eigenvalues + N_Y)) return 0;
    set_limits(leg);
    return 1;
}

/* How long the guard takes to fall from the end of a step, as a parabola tells it. */
static double time_left(const Leg *leg, const double *y, const double *after, double size) {
    double pair[2], bend;
    guard_at(leg, y, pair);
    bend = (after[1] - pair[1]) / size;
    if (after[0] < 0.0) return 0.0;
    if (bend < 0.0) return (after[1] + sqrt(after[1] * after[1] - 2.0 * bend * after[0])) / -bend;
    return after[1] < 0.0 ? -after[0] / after[1] : INFINITY;
}

/* Go over to implicit steps where they pay; 1 if so. */
static int goes_over(Leg *leg, const double *guard_after, double size) {
    int stuck = size <= leg->earlier_size;
    double end = leg->time + size, left;
    leg->earlier_size = size;
    if (!(size * leg->fastest > (stuck ? STUCK : HELD))) return 0;
    left = lesser(time_left(leg, leg->y, guard_after, size), leg->horizon - end);
    if (!(left * leg->fastest > LONG_LEFT && leg->fastest > PAYS * staying_rate(leg, left)))
        return 0;
    leg->size = lesser(greater(2 * size, lesser(leg->first, 1.1 * left)), leg->largest_implicit);
    leg->implicit = 1;
    leg->refused = leg->has_last = 0;
    return 1;
}

/* A first step from the sizes of state and slope; 0 if the flow is not finite. */
static double first_size(const Leg *leg) {
    double slope[N_Y], floor = leg->absolute / leg->relative, ratio = 0.0;
    int i;
    rate_at(leg, leg->y, slope);
    for (i = 0; i < N_Y; i++)
        if (!isfinite(slope[i])) return 0.0;
    for (i = 0; i < N_Y; i++) ratio = greater(ratio, fabs(slope[i]) / (floor + fabs(leg->y[i])));
    return ratio > 1e-5 ? 0.01 / ratio : 1e-3;
}

/* Follow a leg until it ends, the record is full, or the caller must look at it. */
CASADI_SYMBOL_EXPORT int zk_follow(Leg *leg) {
    Found found;
    int i;
    leg->n_recorded = leg->n_polynomials = 0;
    if (!leg->started) {
        leg->started = 1;
        leg->time = leg->largest_change = leg->earlier_size = leg->fastest = leg->first = 0.0;
        leg->refused = leg->has_last = leg->has_rates = leg->n_steps = leg->n_explicit = 0;
        leg->largest_explicit = lesser(leg->largest_explicit, leg->horizon);
        leg->largest_implicit = lesser(leg->largest_implicit, leg->horizon);
        guard_at(leg, leg->y, leg->guard);
        leg->size = first_size(leg);
        if (leg->size == 0.0) return NOT_FINITE;
        leg->size = lesser(leg->size, leg->implicit ? leg->largest_implicit : leg->largest_explicit);
    }
    while (leg->n_recorded < leg->capacity) {
        double told[3], after[N_Y], fall, end, error, factor, *row;
        double size = leg->size, pair[2] = {leg->guard[0], leg->guard[1]}, ended[1 + N_Y] = {NAN};
        Step step = {{look_inside, size, 0}, leg, leg->y, after, told + 1, 0, ended};
        if (leg->implicit) {
            double ratio = leg->has_last ? size / leg->last_size : 0.0;
            int solved = implicit_step(leg, leg->y, size, leg->has_last ? leg->coefficients : 0,
                                       leg->has_last ? 1.0 : 0.0, ratio, &found);
            error = solved ? found.told[2] : INFINITY;
            factor = UNSOLVED;
            if (error < INFINITY)
                factor = IMPLICIT_SAFETY * pow(greater(error, 1e-300), -1.0 / (N_S + 1));
            if (!(error <= 1.0)) {
                leg->size *= greater(IMPLICIT_SHRINK, lesser(factor, leg->has_last ? 1.0 : 0.5));
                leg->refused = 1;
                if (!(leg->size > 4 * spacing(leg->time)) || leg->size < 1e-300)
                    return IMPLICIT_SINGULAR;
                continue;
            }
            memcpy(after, found.after, sizeof after);
            memcpy(leg->coefficients, found.coefficients, sizeof found.coefficients);
            memcpy(leg->polynomials + leg->n_polynomials * N_S * N_Y, found.coefficients,
                   sizeof found.coefficients);
            leg->n_polynomials++;
            memcpy(told, found.told + 2, sizeof told);
            step.coefficients = leg->coefficients;
            leg->last_size = size;
            leg->has_last = 1;
        } else {
            explicit_step(leg, leg->y, size, after, told);
            error = told[0];
            if (!(error <= 1.0)) {
                factor = EXPLICIT_SHRINK;
                if (isfinite(error)) factor = EXPLICIT_SAFETY * pow(error, EXPLICIT_EXPONENT);
                leg->size *= greater(EXPLICIT_SHRINK, factor);
                leg->refused = 1;
                if (leg->size <= 4 * spacing(leg->time) || leg->size < 1e-300)
                    return EXPLICIT_SINGULAR;
                continue;
            }
        }
        row = leg->rows + leg->n_recorded * (2 + N_Y);
        row[0] = leg->time;
        row[1] = size;
        memcpy(row + 2, after, sizeof after);
        leg->n_recorded++;
        leg->n_steps++;
        if (!leg->implicit) leg->n_explicit++;

        fall = first_fall(&step.curve, pair, told + 1, (int)leg->on_guard);
        if (!isnan(fall) && leg->on_guard && is_rounding(&step, fall)) fall = NAN;
        end = isnan(fall) ? size : fall;
        if (leg->time + end >= leg->horizon || !isnan(fall)) {
            int over = leg->time + end >= leg->horizon;
            leg->offset = over ? leg->horizon - leg->time : fall;
            leg_end(&step, leg->offset, leg->end);
            return over ? HORIZON : FALL;
        }
        if (leg->switches && !leg->implicit &&
            (leg->n_explicit == FIRST_LOOK || leg->n_explicit % PATIENCE == 0)) {
            if (leg->has_rates)
                set_limits(leg);
            else if (!look(leg, after)) {
                /* The step is taken back: it comes again once the caller knows the rates. */
                leg->n_recorded--;
                leg->n_steps--;
                leg->n_explicit--;
                return RATES;
            }
            leg->has_rates = 0;
        }
        if (leg->on_guard) {
            double change = greater(leg->largest_change, fabs(pair[1]) * size);
            leg->largest_change = greater(change, fabs(told[2]) * size);
            if (told[1] < -greater(LEAVES * leg->largest_change, leg->rounding)) {
                memcpy(leg->end, leg->y, sizeof leg->end);
                return LEFT;
            }
            leg->on_guard = told[1] <= leg->rounding;
        }
        leg->guard[0] = told[1];
        leg->guard[1] = told[2];

        if (leg->implicit) {
            leg->size = lesser(size * lesser(leg->refused ? 1.0 : IMPLICIT_GROW, factor),
                               leg->largest_implicit);
            leg->time += size;
            leg->refused = 0;
        } else {
            int over = leg->switches && goes_over(leg, told + 1, size);
            leg->time += size;
            if (!over) {
                double growth = EXPLICIT_GROW;
                if (error != 0.0) growth = EXPLICIT_SAFETY * pow(error, EXPLICIT_EXPONENT);
                leg->size *= lesser(leg->refused ? 1.0 : EXPLICIT_GROW,
                                    greater(EXPLICIT_SHRINK, growth));
                leg->size = lesser(leg->size, leg->largest_explicit);
                leg->refused = 0;
            }
        }
        memcpy(leg->y, after, sizeof after);
        for (i = 0; i < N_Y; i++)
            if (fabs(after[i]) > leg->reach[i]) return FAR;
    }
    return FULL;
}
