/* Newton's method of a return, as `closed_return` in Python has it, where nothing is unusual: one
   stop, one event at a time, conditions and directions that are clearly independent. Anything else
   is left to the reference, which decides from the start. */

#define CLOSE_ITERATIONS 30
#define CLOSE_CORRECTIONS 20
#define CLOSE_WAIT 1.05
#define CLOSE_LONGEST 4.0
#define CLOSE_AT_ONCE 1e-9
#define CLOSE_NOTHING 1e-12
#define CLOSE_DECAYED 1e-6
#define CLOSE_ROUNDED 1e-9
#define CLOSE_MISSED 1e-6
#define CLOSE_FAR 1e-4
#define CLOSE_ROUNDING 1e-10
#define CLOSE_HALVES 0.5
#define CLOSE_SHRINKS 0.1
/* As in Python. */
#define CLOSE_CLEAR 1e-7
/* Part of its size that a row or a pivot keeps beside the others. The reference treats less. */
#define CLOSE_EXACT 4e-16
#define CLOSE_ON 1e-9

enum { CLOSE_ROWS = 3 };

typedef struct {
    const zl_problem *problem, *view;
    const zl_tangent *tangent;
    zl_run *run, *other;
    zl_records *records;
    zl_closing *closing;
    zl_track track;
    Tangent t;
    int n, n_rows; /* states, conditions of the section */
} Close;

typedef double Square[ZL_MOST][ZL_MOST];

static const double *close_arc(const Close *c, long long arc) {
    return c->records->arcs + arc * (ZL_ARC_WIDTH + 2 * c->n + 2);
}

static const double *close_event(const Close *c, long long event) {
    return c->records->events + event * (ZL_EVENT_WIDTH + 2 * c->n);
}

/* Take from a direction its parts along others, twice for rounding, and return what is left. */
static double made_orthogonal(Square basis, int count, int n, double *direction, double *parts) {
    double square = 0.0;
    int k, i, again;
    for (k = 0; k < count; k++) parts[k] = 0.0;
    for (again = 0; again < 2; again++)
        for (k = 0; k < count; k++) {
            double along = 0.0;
            for (i = 0; i < n; i++) along += basis[k][i] * direction[i];
            for (i = 0; i < n; i++) direction[i] -= along * basis[k][i];
            parts[k] += along;
        }
    for (i = 0; i < n; i++) square += direction[i] * direction[i];
    return sqrt(square);
}

/* Gradients of the conditions at a state as lower times orthonormal rows, by states of given sizes;
   0 if they are not clearly independent. */
static int conditions_rows(const Close *c, const double *x, const double *sizes, Square basis,
                           double lower[CLOSE_ROWS][ZL_MOST]) {
    const int which[CLOSE_ROWS] = {C_GAP, C_RATE, C_MULTIPLIER};
    const double *slopes = slopes_at(&c->t, ZL_CONTACT_SLOPES, x);
    int k, i;
    for (k = 0; k < c->n_rows; k++) {
        double square = 0.0, length;
        for (i = 0; i < c->n; i++) {
            basis[k][i] = slopes[i * C_ROWS + which[k]] * sizes[i];
            square += basis[k][i] * basis[k][i];
        }
        length = made_orthogonal(basis, k, c->n, basis[k], lower[k]);
        if (!(length > CLOSE_CLEAR * sqrt(square)) || isinf(length)) return 0;
        lower[k][k] = length;
        for (i = 0; i < c->n; i++) basis[k][i] /= length;
    }
    return 1;
}

/* Complete rows to a basis by the unit vectors that they leave longest. */
static void complete_basis(Square basis, int count, int n) {
    double parts[ZL_MOST];
    int k, i, j;
    for (k = count; k < n; k++) {
        double best = -1.0, length;
        int chosen = 0;
        for (i = 0; i < n; i++) {
            double left = 1.0;
            for (j = 0; j < k; j++) left -= basis[j][i] * basis[j][i];
            if (left > best) {
                best = left;
                chosen = i;
            }
        }
        for (i = 0; i < n; i++) basis[k][i] = i == chosen;
        length = made_orthogonal(basis, k, n, basis[k], parts);
        for (i = 0; i < n; i++) basis[k][i] /= length;
    }
}

/* Move a state to the release nearby, in states of the problem's sizes; 0 if there is none. */
static int to_release(const Close *c, double *x) {
    const double *sizes = c->closing->sizes;
    double lower[CLOSE_ROWS][ZL_MOST], values[CLOSE_ROWS + 1], parts[CLOSE_ROWS];
    double largest = INFINITY;
    Square basis;
    int count, k, i;
    for (count = 0; count < CLOSE_CORRECTIONS && largest > CLOSE_EXACT; count++) {
        if (!conditions_rows(c, x, sizes, basis, lower)) return 0;
        evaluate_at(&c->t.m, ZL_GAP, x, values);
        evaluate_at(&c->t.m, ZL_GUARD + ZL_LOCKED, x, values + 2);
        for (k = 0; k < c->n_rows; k++) {
            parts[k] = values[k];
            for (i = 0; i < k; i++) parts[k] -= lower[k][i] * parts[i];
            parts[k] /= lower[k][k];
        }
        largest = 0.0;
        for (i = 0; i < c->n; i++) {
            double change = 0.0;
            for (k = 0; k < c->n_rows; k++) change += basis[k][i] * parts[k];
            x[i] -= sizes[i] * change;
            if (!(fabs(change) <= largest)) largest = fabs(change);
            if (isnan(change)) return 0;
        }
    }
    return largest <= CLOSE_ON;
}

/* Move a state onto its section: `on_section`. */
static int to_section(const Close *c, double *x) {
    const size_t places = (size_t)c->problem->n_q * sizeof(double);
    double resting[ZL_MOST];
    if (c->closing->section == ZL_RELEASE) return to_release(c, x);
    to_stop(&c->t.m, x, resting);
    memcpy(x, resting, c->closing->section == ZL_IMPACT ? places : (size_t)c->n * sizeof(double));
    return 1;
}

/* Carry out the motion from the start up to a time, and find the return: ZL_CLOSED, or why not. */
static int motion_returns(Close *c, double until) {
    zl_closing *closing = c->closing;
    zl_settings settings = *closing->settings;
    long long k, count = 0;
    int status;
    settings.until = until;
    if (zl_begin(c->problem, c->run, &settings, closing->p, closing->start)) return ZL_ASKS;
    status = zl_resume(c->problem, c->run, c->records);
    if (status == ZL_FULL || status == ZL_ESTIMATES || status == ZL_CURVE || status == ZL_MODE)
        return ZL_ASKS;
    if (status != ZL_DONE) return ZL_OPEN;
    /* A start in contact is moved to its release. */
    if (!c->records->n_arcs || (c->records->n_events && close_event(c, 0)[0] == ZL_RELEASE))
        return ZL_ASKS;
    for (k = 0; k < c->records->n_events && count < closing->n_returns; k++) {
        const double *event = close_event(c, k);
        count += event[0] == (double)closing->section && event[1] > CLOSE_AT_ONCE * closing->guess;
    }
    closing->n_events = k;
    if (count < closing->n_returns) return ZL_OPEN;
    closing->period = close_event(c, k - 1)[1];
    return closing->period < close_arc(c, c->records->n_arcs - 1)[2] ? ZL_CLOSED : ZL_ASKS;
}

/* Whether the return has one event at a time and begins as its section does. */
static int is_plain(const Close *c) {
    const int modes[] = {ZL_FLIGHT, ZL_LOCKED, ZL_FREE}; /* after an impact, a Zeno point, a release */
    const zl_closing *closing = c->closing;
    const long long last = closing->n_events - 1;
    const double *first = close_arc(c, 0);
    if ((int)first[0] != modes[closing->section]) return 0;
    if (closing->section == ZL_IMPACT && first[12] != 0.0) return 0;
    if (close_event(c, 0)[1] <= CLOSE_AT_ONCE * closing->period) return 0;
    if (last > 0 && close_event(c, last - 1)[1] == closing->period) return 0;
    return last + 1 == c->records->n_events || close_event(c, last + 1)[1] != closing->period;
}

/* The next return of the start, its end and the sizes of states: ZL_CLOSED, or why not. */
static int follow_return(Close *c) {
    zl_closing *closing = c->closing;
    const size_t bytes = (size_t)c->n * sizeof(double);
    long long arc;
    int i, status = motion_returns(c, CLOSE_WAIT * closing->guess);
    if (status == ZL_OPEN && c->run->stage == OVER)
        status = motion_returns(c, CLOSE_LONGEST * closing->guess);
    if (status != ZL_CLOSED) return status;
    if (!is_plain(c)) return ZL_ASKS;
    memcpy(closing->start, close_arc(c, 0) + ZL_ARC_WIDTH, bytes);
    memcpy(closing->end, close_event(c, closing->n_events - 1) + ZL_EVENT_WIDTH + c->n, bytes);
    memset(closing->scale, 0, bytes);
    closing->n_arcs = 0;
    for (arc = 0; arc < c->records->n_arcs; arc++) {
        const double *row = close_arc(c, arc), *end = row + ZL_ARC_WIDTH + c->n;
        closing->n_arcs += row[2] <= closing->period;
        for (i = 0; i < c->n; i++) closing->scale[i] = greater(closing->scale[i], fabs(end[i]));
    }
    for (i = 0; i < c->n; i++)
        if (!(closing->scale[i] > CLOSE_NOTHING * closing->sizes[i]))
            closing->scale[i] = closing->sizes[i];
    if (closing->section == ZL_ZENO) {
        /* Its derivative is that of the contact which it begins. */
        const double *row = close_arc(c, closing->n_arcs);
        if ((int)row[0] != ZL_LOCKED || row[1] != closing->period) return ZL_ASKS;
        closing->n_arcs++;
    }
    return ZL_CLOSED;
}

/* A start beside the stop of its flight is met on the stop, before or after. */
static void leave_stop(const Close *c, double *shift) {
    const Tangent *t = &c->t;
    const double *x = c->closing->start, unit = close_arc(c, 0)[3];
    const double *slopes = slopes_at(t, ZL_CONTACT_SLOPES, x);
    double gap[2], rate[ZL_MOST], delay[2 * ZL_MOST], fall = 0.0;
    int i;
    evaluate_at(&t->m, ZL_GAP, x, gap);
    if (gap[1] >= unit / 2) {
        evaluate_at(&t->m, ZL_RATE + ZL_FREE, x, rate);
        for (i = 0; i < c->n; i++) fall += slopes[i * C_ROWS + C_GAP] * rate[i];
        total(t, slopes, C_ROWS, C_GAP, shift + T_STATE * t->width, delay);
        for (i = 0; i < t->width; i++) delay[i] /= -fall;
        add_row(shift + T_TIME * t->width, delay, 1.0, t->width);
        for (i = 0; i < c->n; i++)
            add_row(shift + (T_STATE + i) * t->width, delay, rate[i], t->width);
    }
    total(t, slopes, C_ROWS, C_RATE, shift + T_STATE * t->width, shift + T_RATE * t->width);
}

/* Follow the arcs up to a release or the end, from one on; returns the next arc, 0 without it. */
static long long follow_arcs(Close *c, long long arc, long long *event) {
    const long long n_arcs = c->closing->n_arcs;
    const long long size = (T_STATE + c->n) * c->t.width, first = *event;
    const double *rows = close_arc(c, arc);
    long long end = arc, found;
    while (end < n_arcs && (int)close_arc(c, end)[5] != ZL_RELEASE) end++;
    end += end < n_arcs;
    if (end < n_arcs && (int)close_arc(c, end)[0] == ZL_FLIGHT) return 0;
    while (*event < c->records->n_events && close_event(c, *event)[1] <= close_arc(c, end - 1)[2])
        ++*event;
    c->track.arcs = rows;
    c->track.n_arcs = end - arc;
    c->track.events = close_event(c, first);
    c->track.n_events = *event - first;
    if (zl_begin(c->view, c->other, c->closing->settings, c->closing->p, c->closing->start))
        return 0;
    found = zl_follow(c->view, c->tangent, c->other, &c->track, 0,
                      c->closing->shifts + 3 * arc * size);
    return found == end - arc ? end : 0;
}

/* A start off the stop that it leaves is moved onto it: apply that to the derivative of the end. */
static void onto_stop(const Close *c) {
    const double *slopes = slopes_at(&c->t, ZL_CONTACT_SLOPES, c->closing->start);
    double normal[ZL_MOST], square = 0.0;
    int i, k;
    for (k = 0; k < c->n; k++) {
        normal[k] = slopes[k * C_ROWS + C_GAP] * c->closing->scale[k];
        square += normal[k] * normal[k];
    }
    for (i = 0; i < c->n; i++) {
        double *row = c->closing->by_state + i * c->n, along = 0.0;
        for (k = 0; k < c->n; k++) along += row[k] * c->closing->scale[k] * normal[k] / square;
        for (k = 0; k < c->n; k++) row[k] -= along * slopes[k * C_ROWS + C_GAP];
    }
}

/* The derivative of the return; 0 if an arc has none. */
static int differentiate(Close *c) {
    zl_closing *closing = c->closing;
    Tangent *t = &c->t;
    const long long size = (T_STATE + c->n) * t->width;
    double *start = closing->shifts + 2 * size, *last;
    double *contact = c->records->arcs + (closing->n_arcs - 1) * (ZL_ARC_WIDTH + 2 * c->n + 2);
    const double ending = contact[5];
    const int at_zeno = closing->section == ZL_ZENO;
    long long arc, event = 0, step;
    int i, k;
    clear_rows(start, size);
    for (i = 0; i < c->n; i++) start[(T_STATE + i) * t->width + i] = 1.0;
    if (closing->section == ZL_IMPACT) leave_stop(c, start);
    /* Of the contact after the return only the start is asked. */
    if (at_zeno) contact[5] = ZL_ZENO;
    for (arc = 0, step = 1; step && arc < closing->n_arcs; arc = step)
        step = follow_arcs(c, arc, &event);
    contact[5] = ending;
    if (!step) return 0;
    last = shift_of(t, closing->shifts, closing->n_arcs - 1, at_zeno ? 0 : 2);
    for (i = 0; i < c->n; i++)
        for (k = 0; k < c->n; k++) {
            const double slope = last[(T_STATE + i) * t->width + k];
            if (!isfinite(slope)) return 0;
            closing->by_state[i * c->n + k] = slope;
        }
    if (closing->section == ZL_IMPACT) onto_stop(c);
    return 1;
}

/* Invert a matrix in place; 0 if a pivot nearly vanishes. */
static int inverted(Square a, int n) {
    Square inverse;
    double largest = 0.0;
    int i, j, k;
    for (i = 0; i < n; i++)
        for (j = 0; j < n; j++) {
            inverse[i][j] = i == j;
            largest = greater(largest, fabs(a[i][j]));
        }
    for (k = 0; k < n; k++) {
        int pivot = k;
        for (i = k + 1; i < n; i++)
            if (fabs(a[i][k]) > fabs(a[pivot][k])) pivot = i;
        if (!(fabs(a[pivot][k]) > CLOSE_CLEAR * greater(largest, 1.0))) return 0;
        for (j = 0; j < n; j++) {
            const double kept = a[k][j], other = inverse[k][j];
            a[k][j] = a[pivot][j];
            a[pivot][j] = kept;
            inverse[k][j] = inverse[pivot][j];
            inverse[pivot][j] = other;
        }
        for (i = 0; i < n; i++) {
            const double factor = a[i][k] / a[k][k];
            if (i == k) continue;
            for (j = 0; j < n; j++) {
                a[i][j] -= factor * a[k][j];
                inverse[i][j] -= factor * inverse[k][j];
            }
        }
    }
    for (i = 0; i < n; i++) {
        const double pivot = a[i][i];
        for (j = 0; j < n; j++) a[i][j] = inverse[i][j] / pivot;
    }
    return 1;
}

/* The inverse of the identity minus the derivative, on admissible changes of the start:
   `inverse_of_closing`. */
static int invert_closing(const Close *c, Square inverse) {
    const zl_closing *closing = c->closing;
    const double *scale = closing->scale;
    double lower[CLOSE_ROWS][ZL_MOST];
    Square basis, inner;
    const int d = c->n - c->n_rows;
    int i, j, k, l;
    if (!conditions_rows(c, closing->start, scale, basis, lower)) return 0;
    complete_basis(basis, c->n_rows, c->n);
    for (k = 0; k < d; k++)
        for (l = 0; l < d; l++) {
            const double *left = basis[c->n_rows + k], *right = basis[c->n_rows + l];
            inner[k][l] = 0.0;
            for (i = 0; i < c->n; i++)
                for (j = 0; j < c->n; j++) {
                    const double entry = (i == j) - closing->by_state[i * c->n + j];
                    inner[k][l] += left[i] * entry * scale[j] / scale[i] * right[j];
                }
        }
    if (!inverted(inner, d)) return 0;
    for (i = 0; i < c->n; i++)
        for (j = 0; j < c->n; j++) {
            double entry = 0.0;
            for (k = 0; k < d; k++)
                for (l = 0; l < d; l++)
                    entry += basis[c->n_rows + k][i] * inner[k][l] * basis[c->n_rows + l][j];
            inverse[i][j] = entry * scale[i] / scale[j];
        }
    return 1;
}

/* The rank-one update of an inverse by the step between two returns: `_improved`. */
static void improve(const Close *c, const double *start, const double *end, Square inverse) {
    const zl_closing *closing = c->closing;
    double step[ZL_MOST], told[ZL_MOST], row[ZL_MOST], length = 0.0;
    int i, j;
    for (i = 0; i < c->n; i++) {
        step[i] = closing->start[i] - start[i];
        told[i] = end[i] - start[i] - (closing->end[i] - closing->start[i]);
    }
    for (j = 0; j < c->n; j++) {
        row[j] = 0.0;
        for (i = 0; i < c->n; i++)
            row[j] += step[i] / (closing->scale[i] * closing->scale[i]) * inverse[i][j];
        length += row[j] * told[j];
    }
    if (length == 0.0) return;
    for (i = 0; i < c->n; i++)
        for (j = 0; j < c->n; j++) step[i] -= inverse[i][j] * told[j];
    for (i = 0; i < c->n; i++)
        for (j = 0; j < c->n; j++) inverse[i][j] += step[i] * row[j] / length;
}

static void times_missed(const Close *c, Square inverse, double *change) {
    int i, j;
    for (i = 0; i < c->n; i++) {
        change[i] = 0.0;
        for (j = 0; j < c->n; j++)
            change[i] += inverse[i][j] * (c->closing->end[j] - c->closing->start[j]);
    }
}

/* Go on by a correction, which is shortened if a state leaps. */
static void go_to(const Close *c, const double *change) {
    zl_closing *closing = c->closing;
    double unit[ZL_MOST], shares = 0.0, leap;
    int i;
    for (i = 0; i < c->n; i++) shares = greater(shares, closing->scale[i] / closing->sizes[i]);
    if (shares == 0.0) shares = 1.0;
    for (i = 0; i < c->n; i++) {
        const double share = closing->scale[i] / closing->sizes[i];
        unit[i] = (share > CLOSE_DECAYED * shares ? share : shares) * closing->sizes[i];
    }
    leap = largest_part(change, unit, c->n);
    for (i = 0; i < c->n; i++)
        closing->start[i] += leap > 0.5 ? change[i] * (0.5 / leap) : change[i];
}

static Close close_of(const zl_problem *problem, zl_run *run, const zl_problem *view,
                      const zl_tangent *tangent, zl_run *other, zl_records *records,
                      zl_closing *closing) {
    Close c;
    memset(&c, 0, sizeof c);
    c.problem = problem;
    c.view = view;
    c.tangent = tangent;
    c.run = run;
    c.other = other;
    c.records = records;
    c.closing = closing;
    c.n = (int)problem->n_x;
    c.n_rows = closing->section == ZL_RELEASE ? 3 : closing->section == ZL_ZENO ? 2 : 1;
    c.track.steps = records->steps;
    c.track.polynomials = records->polynomials;
    c.track.trusted = closing->trusted;
    c.track.estimates = records->estimates;
    c.track.work = closing->work;
    return c;
}

int zl_close(const zl_problem *problem, zl_run *run, const zl_problem *view,
             const zl_tangent *tangent, zl_run *other, zl_records *records, zl_closing *closing) {
    Close c = close_of(problem, run, view, tangent, other, records, closing);
    double size = INFINITY, limit = CLOSE_HALVES, start[ZL_MOST], end[ZL_MOST], change[ZL_MOST];
    const size_t bytes = sizeof start;
    Square inverse;
    int count, status;
    if (c.n_rows > c.n || zl_begin(view, other, closing->settings, closing->p, closing->start))
        return ZL_ASKS;
    c.t = tangent_of(view, tangent, other, &c.track, records);
    prepare_all(&c.t);
    for (count = 0; count < CLOSE_ITERATIONS; count++) {
        double before = size;
        int is_new = count == 0;
        if (!to_section(&c, closing->start)) return ZL_ASKS;
        status = follow_return(&c);
        if (status != ZL_CLOSED) return status;
        if (!is_new) {
            if (before > CLOSE_ROUNDED) improve(&c, start, end, inverse);
            times_missed(&c, inverse, change);
            is_new = !(largest_part(change, closing->scale, c.n) < limit * before);
        }
        if (is_new) {
            if (limit > CLOSE_SHRINKS) before = INFINITY;
            if (!differentiate(&c) || !invert_closing(&c, inverse)) return ZL_ASKS;
            limit = CLOSE_SHRINKS;
            times_missed(&c, inverse, change);
        }
        size = largest_part(change, closing->scale, c.n);
        memcpy(start, closing->start, bytes);
        memcpy(end, closing->end, bytes);
        if (size <= 0.1 * closing->exact || (before <= CLOSE_ROUNDING && size <= CLOSE_ROUNDING &&
                                             !(size < before))) {
            for (count = 0; count < c.n; count++) end[count] -= start[count];
            if (!(largest_part(end, closing->scale, c.n) <= greater(CLOSE_MISSED, 10 * closing->exact)))
                return ZL_ASKS;
            return is_new || differentiate(&c) ? ZL_CLOSED : ZL_ASKS;
        }
        if (!(size < before)) return before > CLOSE_FAR ? ZL_OPEN : ZL_ASKS;
        closing->guess = closing->period;
        go_to(&c, change);
    }
    return ZL_ASKS;
}
