/* Newton's method of a return, as `closed_return` in Python has it, with one stop, one event at a time
   and clearly independent directions. Anything else is left to the reference. */

#define CLOSE_ITERATIONS 30
#define CLOSE_CORRECTIONS 20
#define CLOSE_WAIT 1.05
#define CLOSE_LONGEST 4.0
#define CLOSE_AT_ONCE 1e-9
#define CLOSE_NOTHING 1e-12
#define CLOSE_LONG 0.5
#define CLOSE_DECAYED 1e-6
#define CLOSE_ROUNDED 1e-9
#define CLOSE_MISSED 1e-6
#define CLOSE_FAR 1e-4
#define CLOSE_ROUNDING 1e-10
#define CLOSE_SHRINKS 0.1
#define CLOSE_EXACT 4e-16
#define CLOSE_ON 1e-9
/* As in Python, but for the part of its size that a row or a pivot keeps beside the others. */
#define CLOSE_CLEAR 1e-7

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

/* Write rows as lower times orthonormal rows; 0 if they are not clearly independent. */
static int triangular(Square rows, int count, int n, Square lower) {
    int k, i;
    for (k = 0; k < count; k++) {
        double square = 0.0;
        for (i = 0; i < n; i++) square += rows[k][i] * rows[k][i];
        lower[k][k] = made_orthogonal(rows, k, n, rows[k], lower[k]);
        if (!(lower[k][k] > CLOSE_CLEAR * sqrt(square)) || isinf(square)) return 0;
        for (i = 0; i < n; i++) rows[k][i] /= lower[k][k];
    }
    return 1;
}

/* The shortest solution of equations with such rows. */
static void shortest(Square rows, Square lower, int count, int n, const double *values, double *x) {
    double parts[ZL_MOST];
    int k, i;
    for (i = 0; i < n; i++) x[i] = 0.0;
    for (k = 0; k < count; k++) {
        parts[k] = values[k];
        for (i = 0; i < k; i++) parts[k] -= lower[k][i] * parts[i];
        parts[k] /= lower[k][k];
        for (i = 0; i < n; i++) x[i] += rows[k][i] * parts[k];
    }
}

/* Gradients of the conditions of the section at a state, by states of given sizes. */
static int conditions_rows(const Close *c, const double *x, const double *sizes, Square rows,
                           Square lower) {
    const int which[] = {C_GAP, C_RATE, C_MULTIPLIER};
    const double *slopes = slopes_at(&c->t, ZL_CONTACT_SLOPES, x);
    int k, i;
    for (k = 0; k < c->n_rows; k++)
        for (i = 0; i < c->n; i++) rows[k][i] = slopes[i * C_ROWS + which[k]] * sizes[i];
    return triangular(rows, c->n_rows, c->n, lower);
}

/* Move a state to the release nearby, in states of the problem's sizes; 0 if there is none. */
static int to_release(const Close *c, double *x) {
    const double *sizes = c->closing->sizes;
    double values[4], change[ZL_MOST], largest = INFINITY;
    Square rows, lower;
    int count, i;
    for (count = 0; count < CLOSE_CORRECTIONS && largest > CLOSE_EXACT; count++) {
        if (!conditions_rows(c, x, sizes, rows, lower)) return 0;
        evaluate_at(&c->t.m, ZL_GAP, x, values);
        evaluate_at(&c->t.m, ZL_GUARD + ZL_LOCKED, x, values + 2);
        shortest(rows, lower, c->n_rows, c->n, values, change);
        for (i = 0; i < c->n; i++) change[i] *= sizes[i];
        for (i = 0; i < c->n; i++) x[i] -= change[i];
        largest = largest_part(change, sizes, c->n);
        if (isnan(largest)) return 0;
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
    if (status > ZL_CURVE && status != ZL_MODE) return ZL_OPEN;
    if (status != ZL_DONE) return ZL_ASKS;
    /* A start in contact is moved to its release. */
    if (!c->records->n_arcs || (closing->section == ZL_RELEASE && c->records->n_events &&
                               close_event(c, 0)[0] == ZL_RELEASE))
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
    /* After an impact, a Zeno point, a release. */
    const int modes[] = {ZL_FLIGHT, ZL_LOCKED, ZL_FREE};
    const zl_closing *closing = c->closing;
    const long long last = closing->n_events - 1;
    const double *first = close_arc(c, 0);
    if ((int)first[0] != modes[closing->section] ||
        (closing->section == ZL_IMPACT && first[12] != 0.0) ||
        close_event(c, 0)[1] <= CLOSE_AT_ONCE * closing->period ||
        (last > 0 && close_event(c, last - 1)[1] == closing->period))
        return 0;
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
    /* Only starts on the stop count. After an impact they leave it with rates of their own. */
    if (closing->section == ZL_IMPACT)
        total(t, slopes_at(t, ZL_CONTACT_SLOPES, closing->start), C_ROWS, C_RATE,
              start + T_STATE * t->width, start + T_RATE * t->width);
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
    return 1;
}

/* The inverse of the identity minus the derivative, on admissible changes of the start:
   `inverse_of_closing`. */
static int invert_closing(const Close *c, Square inverse) {
    const double *scale = c->closing->scale;
    Square rows, matrix, lower;
    double column[ZL_MOST], found[ZL_MOST], parts[ZL_MOST];
    const int n = c->n;
    int i, j, k;
    if (!conditions_rows(c, c->closing->start, scale, rows, lower)) return 0;
    for (i = 0; i < n; i++) {
        for (j = 0; j < n; j++)
            matrix[i][j] = ((i == j) - c->closing->by_state[i * n + j]) * scale[j] / scale[i];
        made_orthogonal(rows, c->n_rows, n, matrix[i], parts);
    }
    /* Across the section it is the identity. */
    for (j = 0; j < n; j++) {
        for (i = 0; i < n; i++) column[i] = matrix[i][j];
        made_orthogonal(rows, c->n_rows, n, column, parts);
        for (i = 0; i < n; i++)
            for (matrix[i][j] = column[i], k = 0; k < c->n_rows; k++)
                matrix[i][j] += rows[k][i] * rows[k][j];
    }
    if (!triangular(matrix, n, n, lower)) return 0;
    for (j = 0; j < n; j++) {
        if (!(lower[j][j] > CLOSE_CLEAR)) return 0;
        for (i = 0; i < n; i++) column[i] = i == j;
        made_orthogonal(rows, c->n_rows, n, column, parts);
        shortest(matrix, lower, n, n, column, found);
        for (i = 0; i < n; i++) inverse[i][j] = found[i] * scale[i] / scale[j];
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
    for (i = 0; i < c->n; i++)
        for (change[i] = 0.0, j = 0; j < c->n; j++)
            change[i] += inverse[i][j] * (c->closing->end[j] - c->closing->start[j]);
}

int zl_close(const zl_problem *problem, zl_run *run, const zl_problem *view,
             const zl_tangent *tangent, zl_run *other, zl_records *records, zl_closing *closing) {
    Close c = {.problem = problem, .view = view, .tangent = tangent, .run = run, .other = other,
               .records = records, .closing = closing, .n = (int)problem->n_x,
               .track = {.steps = records->steps, .polynomials = records->polynomials,
                         .trusted = closing->trusted, .estimates = records->estimates,
                         .work = closing->work}};
    double size = INFINITY, limit = CLOSE_LONG, least;
    double start[ZL_MOST], end[ZL_MOST], change[ZL_MOST];
    Square inverse;
    int count, status, i;
    c.n_rows = closing->section == ZL_RELEASE ? 3 : closing->section == ZL_ZENO ? 2 : 1;
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
        memcpy(start, closing->start, sizeof start);
        memcpy(end, closing->end, sizeof end);
        if (size <= 0.1 * closing->exact || (before <= CLOSE_ROUNDING && size <= CLOSE_ROUNDING &&
                                             !(size < before))) {
            for (i = 0; i < c.n; i++) end[i] -= start[i];
            if (!(largest_part(end, closing->scale, c.n) <=
                  greater(CLOSE_MISSED, 10 * closing->exact)))
                return ZL_ASKS;
            return is_new || differentiate(&c) ? ZL_CLOSED : ZL_ASKS;
        }
        if (!(size < before)) return before > CLOSE_FAR ? ZL_OPEN : ZL_ASKS;
        closing->guess = closing->period;
        least = largest_part(closing->scale, closing->sizes, c.n) * CLOSE_DECAYED;
        for (i = 0; i < c.n; i++) {
            /* The reference measures a state that has decayed otherwise. */
            if (size > CLOSE_LONG && !(closing->scale[i] > least * closing->sizes[i]))
                return ZL_ASKS;
            closing->start[i] += size > CLOSE_LONG ? change[i] * (CLOSE_LONG / size) : change[i];
        }
    }
    return ZL_ASKS;
}
