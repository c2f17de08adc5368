/* Tapes in intervals: bounds of a guard over a box of states, as `guard_intervals` in Python has
   them. What depends on parameters alone is one number. Rounding is left out, a part of 1e-16. */

/* Stands for a bound where none is known, as of a quotient by an interval around zero. */
#define WIDE 1e300

#define PI 3.141592653589793

typedef struct {
    double low, high;
} Interval;

/* Additions to bounds: zero, or WIDE if an operation in them is not bounded. Those of jumps are for
   derivatives alone: a guard with a jump in the box has none. */
typedef struct {
    double total, jumps;
} Doubt;

static double minimum(double x, double y) { return x <= y || y != y ? x : y; }

static double maximum(double x, double y) { return x >= y || y != y ? x : y; }

static Interval between(double low, double high) {
    Interval found;
    found.low = low;
    found.high = high;
    return found;
}

static int doubted(int condition, Doubt *doubt) {
    if (condition) doubt->total += WIDE;
    return condition;
}

static Interval sum_of(Interval a, Interval b) { return between(a.low + b.low, a.high + b.high); }

static Interval difference_of(Interval a, Interval b) {
    return between(a.low - b.high, a.high - b.low);
}

static Interval hull_of(double a, double b, double c, double d) {
    return between(minimum(minimum(minimum(a, b), c), d), maximum(maximum(maximum(a, b), c), d));
}

static Interval product_of(Interval a, Interval b) {
    if (a.low == a.high) {
        const Interval other = b;
        b = a;
        a = other;
    }
    if (b.low == b.high)
        return b.low >= 0.0 ? between(a.low * b.low, a.high * b.low)
                            : between(a.high * b.low, a.low * b.low);
    return hull_of(a.low * b.low, a.low * b.high, a.high * b.low, a.high * b.high);
}

static Interval inverse_of(Interval a, Doubt *doubt) {
    if (a.low == a.high && a.low != 0.0) return between(1.0 / a.low, 1.0 / a.low);
    if (doubted(a.low * a.high <= 0.0, doubt)) return between(0.0, 0.0);
    return between(1.0 / a.high, 1.0 / a.low);
}

static Interval size_of(Interval a) {
    return between(maximum(maximum(a.low, -a.high), 0.0), maximum(-a.low, a.high));
}

static Interval square_of(Interval a) {
    const Interval size = size_of(a);
    return between(size.low * size.low, size.high * size.high);
}

static Interval log_of(Interval a, Doubt *doubt) {
    if (doubted(a.low <= 0.0, doubt)) a = between(1.0, a.low <= 0.0 ? 1.0 : a.high);
    return between(log(a.low), log(a.high));
}

static Interval power_of(Interval a, double exponent, Doubt *doubt) {
    Interval size;
    if (exponent < 0.0) return inverse_of(power_of(a, -exponent, doubt), doubt);
    if (fmod(exponent, 2.0) == 1.0) return between(pow(a.low, exponent), pow(a.high, exponent));
    if (fmod(exponent, 2.0) == 0.0) {
        size = size_of(a);
    } else {
        doubted(a.low < 0.0, doubt);
        size = between(maximum(a.low, 0.0), maximum(a.high, 0.0));
    }
    return between(pow(size.low, exponent), pow(size.high, exponent));
}

/* A power of a positive base, which is monotone in base and exponent. */
static Interval any_power_of(Interval a, Interval b, Doubt *doubt) {
    if (doubted(a.low <= 0.0, doubt)) a = between(1.0, 1.0);
    return hull_of(pow(a.low, b.low), pow(a.low, b.high), pow(a.high, b.low), pow(a.high, b.high));
}

/* A sine that has its maxima at `top` and every turn from there, of its values at both ends. */
static Interval wave_of(Interval a, double start, double end, double top) {
    const double turn = 2.0 * PI;
    /* The last maximum and the last minimum that are not above the interval. */
    const double highest = top + turn * floor((a.high - top) / turn);
    const double lowest = top - PI + turn * floor((a.high - top + PI) / turn);
    return between(lowest >= a.low ? -1.0 : minimum(start, end),
                   highest >= a.low ? 1.0 : maximum(start, end));
}

static Interval tan_of(Interval a, Doubt *doubt) {
    doubted(floor((a.low + PI / 2) / PI) != floor((a.high + PI / 2) / PI), doubt);
    return between(tan(a.low), tan(a.high));
}

/* The part of an interval in which arcs of a sine are known. */
static Interval within_one(Interval a, Doubt *doubt) {
    doubted(a.low < -1.0 || a.high > 1.0, doubt);
    return between(minimum(maximum(a.low, -1.0), 1.0), minimum(maximum(a.high, -1.0), 1.0));
}

static Interval artanh_of(Interval a, Doubt *doubt) {
    if (doubted(a.low <= -1.0 || a.high >= 1.0, doubt)) return between(0.0, 0.0);
    return between(atanh(a.low), atanh(a.high));
}

/* Whether a value is certainly and possibly not zero. */
static Interval truth_of(Interval a) {
    return between(a.low > 0.0 || a.high < 0.0, !(a.low == 0.0 && a.high == 0.0));
}

static Interval equal_to(Interval a, Interval b) {
    const int overlap = a.low <= b.high && b.low <= a.high;
    return between(overlap && a.low == a.high && b.low == b.high, overlap);
}

static Interval negation_of(Interval a) {
    const Interval truth = truth_of(a);
    return between(1.0 - truth.high, 1.0 - truth.low);
}

/* A value where a condition holds and zero elsewhere, both where it is not decided. */
static Interval where_true(Interval condition, Interval a) {
    const Interval truth = truth_of(condition);
    if (truth.high == 0.0) return between(0.0, 0.0);
    if (truth.low != 0.0) return a;
    return between(minimum(a.low, 0.0), maximum(a.high, 0.0));
}

static Interval angle_of(Interval y, Interval x, Doubt *doubt) {
    Interval slope;
    doubted(x.low <= 0.0, doubt);
    slope = product_of(y, inverse_of(x, doubt));
    return between(atan(slope.low), atan(slope.high));
}

static Interval length_of(Interval a, Interval b) {
    const Interval total = sum_of(square_of(a), square_of(b));
    return between(sqrt(total.low), sqrt(total.high));
}

/* The cells of an interval. */
static Interval cells_of(const double *const *tables, double code, Interval x) {
    return between(cell_of(tables, code, x.low), cell_of(tables, code, x.high));
}

/* The cells of phases, by cosines and sines: all cells where the interval holds the end of a turn. */
static Interval cells_of_turn(const double *const *tables, double code, Interval c, Interval s) {
    const double *table = tables[(int)code / SIDES];
    const double angle = atan2(s.low + s.high, c.low + c.high), turn = table[T_LAST];
    const double middle = angle < 0.0 ? angle + turn : angle;
    const Interval cosine = between(cos(angle), cos(angle)), sine = between(sin(angle), sin(angle));
    const Interval ahead = sum_of(product_of(c, cosine), product_of(s, sine));
    const Interval aside = difference_of(product_of(s, cosine), product_of(c, sine));
    Interval phase, cells;
    if (!(ahead.low > 0.0)) return between(0.0, table[T_CELLS] - 1.0);
    phase = between(middle + atan(aside.low / (aside.low < 0.0 ? ahead.low : ahead.high)),
                    middle + atan(aside.high / (aside.high > 0.0 ? ahead.low : ahead.high)));
    cells = cells_of(tables, code, phase);
    if (phase.low < 0.0 || phase.high >= turn || cells.high < cells.low)
        return between(0.0, table[T_CELLS] - 1.0);
    return cells;
}

/* The numbers of cells: those of all where the cells are not close to each other. */
static Interval numbers_of_cells(const double *const *tables, double which, double place,
                                 Interval cell) {
    const double n = tables[(int)which][T_CELLS];
    const double low = number_of_cell(tables, which, place, cell.low);
    const double high = number_of_cell(tables, which, place, cell.high);
    double middle;
    if (isnan(low) || isnan(high)) return between(NAN, NAN);
    if (!(cell.high - cell.low <= 2.0))
        return between(number_of_cell(tables, which, place, n),
                       number_of_cell(tables, which, place, n + 1.0));
    middle = number_of_cell(tables, which, place, floor((cell.low + cell.high) / 2.0));
    return between(minimum(minimum(low, middle), high), maximum(maximum(low, middle), high));
}

static double sign_of(double x) { return x < 0.0 ? -1.0 : x > 0.0 ? 1.0 : x; }

/* Carry out one operation; `exponent` is that of a power with a number, or not finite. */
static Interval operated(int op, Interval x, Interval y, Interval w, double exponent,
                         const double *const *tables, Doubt *doubt) {
    Interval z;
    switch (op) {
    case OP_COPY: return x;
    case OP_ADD: return sum_of(x, y);
    case OP_SUB: return difference_of(x, y);
    case OP_MUL: return product_of(x, y);
    case OP_MUL_ADD: return sum_of(product_of(x, y), w);
    case OP_MUL_SUB: return difference_of(product_of(x, y), w);
    case OP_SUB_MUL: return difference_of(w, product_of(x, y));
    case OP_DIV: return product_of(x, inverse_of(y, doubt));
    case OP_NEG: return between(-x.high, -x.low);
    case OP_SQ: return square_of(x);
    case OP_TWICE: return between(2.0 * x.low, 2.0 * x.high);
    case OP_INV: return inverse_of(x, doubt);
    case OP_SQRT:
        doubted(x.low < 0.0, doubt);
        return between(sqrt(maximum(x.low, 0.0)), sqrt(maximum(x.high, 0.0)));
    case OP_SIN: return wave_of(x, sin(x.low), sin(x.high), PI / 2);
    case OP_COS: return wave_of(x, cos(x.low), cos(x.high), 0.0);
    case OP_TAN: return tan_of(x, doubt);
    case OP_ASIN:
        z = within_one(x, doubt);
        return between(asin(z.low), asin(z.high));
    case OP_ACOS:
        z = within_one(x, doubt);
        return between(acos(z.high), acos(z.low));
    case OP_ATAN: return between(atan(x.low), atan(x.high));
    case OP_ATAN2: return angle_of(x, y, doubt);
    case OP_SINH: return between(sinh(x.low), sinh(x.high));
    case OP_COSH:
        z = size_of(x);
        return between(cosh(z.low), cosh(z.high));
    case OP_TANH: return between(tanh(x.low), tanh(x.high));
    case OP_ASINH: return between(asinh(x.low), asinh(x.high));
    case OP_ACOSH:
        doubted(x.low < 1.0, doubt);
        return between(acosh(maximum(x.low, 1.0)), acosh(maximum(x.high, 1.0)));
    case OP_ATANH: return artanh_of(x, doubt);
    case OP_EXP: return between(exp(x.low), exp(x.high));
    case OP_EXPM1: return between(expm1(x.low), expm1(x.high));
    case OP_LOG: return log_of(x, doubt);
    case OP_LOG1P: return log_of(between(x.low + 1.0, x.high + 1.0), doubt);
    case OP_POW:
        return isfinite(exponent) ? power_of(x, exponent, doubt) : any_power_of(x, y, doubt);
    case OP_HYPOT: return length_of(x, y);
    case OP_ERF: return between(erf(x.low), erf(x.high));
    case OP_FABS: return size_of(x);
    case OP_SIGN: z = between(sign_of(x.low), sign_of(x.high)); break;
    case OP_FLOOR: z = between(floor(x.low), floor(x.high)); break;
    case OP_CEIL: z = between(ceil(x.low), ceil(x.high)); break;
    case OP_LT: z = between(x.high < y.low, x.low < y.high); break;
    case OP_LE: z = between(x.high <= y.low, x.low <= y.high); break;
    case OP_EQ: z = equal_to(x, y); break;
    case OP_NE: z = negation_of(equal_to(x, y)); break;
    case OP_NOT: z = negation_of(x); break;
    case OP_AND:
        x = truth_of(x), y = truth_of(y);
        z = between(minimum(x.low, y.low), minimum(x.high, y.high));
        break;
    case OP_OR:
        x = truth_of(x), y = truth_of(y);
        z = between(maximum(x.low, y.low), maximum(x.high, y.high));
        break;
    case OP_FMIN: return between(minimum(x.low, y.low), minimum(x.high, y.high));
    case OP_FMAX: return between(maximum(x.low, y.low), maximum(x.high, y.high));
    case OP_IF_ELSE_ZERO: return where_true(x, y);
    case OP_CELL: z = cells_of(tables, y.low, x); break;
    case OP_TURN: z = cells_of_turn(tables, w.low, x, y); break;
    case OP_PICK: z = numbers_of_cells(tables, y.low, w.low, x); break;
    default: doubted(1, doubt); return between(0.0, 0.0);
    }
    /* What jumps in the box has no derivative. */
    if (z.low != z.high) doubt->jumps = WIDE;
    return z;
}

static void carry_out_intervals(const zl_tape *tape, long long from, long long to, Interval *r,
                                Doubt *doubt) {
    const zl_instruction *code = tape->code + from, *end = tape->code + to;
    const int constants = (int)(tape->n_varying + tape->n_parameters);
    const int results = constants + (int)tape->n_constants;
    for (; code < end; code++) {
        const double exponent = constants <= code->b && code->b < results ? r[code->b].low : NAN;
        r[code->to] = operated(code->op, r[code->a], r[code->b], r[code->c], exponent,
                               tape->tables, doubt);
    }
}

/* Numbers that the registers of a formula take, with their intervals. */
static long long interval_room(const zl_tape *tape) { return 3 * tape->n_registers; }

/* Write parameters and constants, and do what depends on them alone. */
static void intervals_prepare(const zl_tape *tape, double *registers, const double *p) {
    Interval *r = (Interval *)(void *)(registers + tape->n_registers);
    long long k;
    if (!tape->n_outputs) return;
    tape_prepare(tape, registers, p);
    for (k = tape->n_varying; k < tape->n_registers; k++) r[k] = between(registers[k], registers[k]);
}

/* Write bounds of a guard, its rate and its second derivative over a box: lower ends, then upper.
   Without `all` those of a guard that is positive in the box are enough. */
static void intervals_run(const zl_tape *tape, double *registers, const double *box, int all,
                          double *found) {
    Interval *r = (Interval *)(void *)(registers + tape->n_registers);
    const long long first = tape->n_once + tape->n_first;
    Doubt doubt = {0.0, 0.0};
    long long k;
    for (k = 0; k < tape->n_varying; k++) r[k] = between(box[k], box[tape->n_varying + k]);
    carry_out_intervals(tape, tape->n_once, first, r, &doubt);
    found[0] = r[tape->outputs[0]].low - doubt.total;
    found[1] = r[tape->outputs[0]].high + doubt.total;
    found[2] = found[4] = -WIDE;
    found[3] = found[5] = WIDE;
    if (!all && found[0] > 0.0) return;
    carry_out_intervals(tape, first, tape->n_instructions, r, &doubt);
    for (k = 1; k < tape->n_outputs; k++) {
        found[2 * k] = r[tape->outputs[k]].low - (doubt.total + doubt.jumps);
        found[2 * k + 1] = r[tape->outputs[k]].high + (doubt.total + doubt.jumps);
    }
}
