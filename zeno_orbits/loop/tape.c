/* Tapes: formulas as instructions on registers, one state at a time or several in step. */

#include "lookup.c"

/* The order is that of `tape.py`. The operands are x, y and w. */
enum {
    OP_COPY, OP_ADD, OP_SUB, OP_MUL, OP_DIV, OP_NEG, OP_SQ, OP_TWICE, OP_INV, OP_SQRT, OP_SIN,
    OP_COS, OP_TAN, OP_ASIN, OP_ACOS, OP_ATAN, OP_ATAN2, OP_SINH, OP_COSH, OP_TANH, OP_ASINH,
    OP_ACOSH, OP_ATANH, OP_EXP, OP_EXPM1, OP_LOG, OP_LOG1P, OP_POW, OP_HYPOT, OP_ERF, OP_FABS,
    OP_SIGN, OP_COPYSIGN, OP_FMIN, OP_FMAX, OP_FLOOR, OP_CEIL, OP_FMOD, OP_REMAINDER, OP_LT, OP_LE,
    OP_EQ, OP_NE, OP_NOT, OP_AND, OP_OR, OP_IF_ELSE_ZERO,
    /* A product and a sum, each rounded: two instructions in one. */
    OP_MUL_ADD, OP_MUL_SUB, OP_SUB_MUL,
    /* The cell of x, or of the phase (x, y), in a table; the number of cell x at a place of it. */
    OP_CELL, OP_TURN, OP_PICK
};

#define OPERATIONS(ONE)                                                                            \
    ONE(OP_COPY, x)                                                                                \
    ONE(OP_ADD, x + y)                                                                             \
    ONE(OP_SUB, x - y)                                                                             \
    ONE(OP_MUL, x * y)                                                                             \
    ONE(OP_DIV, x / y)                                                                             \
    ONE(OP_NEG, -x)                                                                                \
    ONE(OP_SQ, x * x)                                                                              \
    ONE(OP_TWICE, 2.0 * x)                                                                         \
    ONE(OP_INV, 1.0 / x)                                                                           \
    ONE(OP_SQRT, sqrt(x))                                                                          \
    ONE(OP_SIN, sin(x))                                                                            \
    ONE(OP_COS, cos(x))                                                                            \
    ONE(OP_TAN, tan(x))                                                                            \
    ONE(OP_ASIN, asin(x))                                                                          \
    ONE(OP_ACOS, acos(x))                                                                          \
    ONE(OP_ATAN, atan(x))                                                                          \
    ONE(OP_ATAN2, atan2(x, y))                                                                     \
    ONE(OP_SINH, sinh(x))                                                                          \
    ONE(OP_COSH, cosh(x))                                                                          \
    ONE(OP_TANH, tanh(x))                                                                          \
    ONE(OP_ASINH, asinh(x))                                                                        \
    ONE(OP_ACOSH, acosh(x))                                                                        \
    ONE(OP_ATANH, atanh(x))                                                                        \
    ONE(OP_EXP, exp(x))                                                                            \
    ONE(OP_EXPM1, expm1(x))                                                                        \
    ONE(OP_LOG, log(x))                                                                            \
    ONE(OP_LOG1P, log1p(x))                                                                        \
    ONE(OP_POW, pow(x, y))                                                                         \
    ONE(OP_HYPOT, hypot(x, y))                                                                     \
    ONE(OP_ERF, erf(x))                                                                            \
    ONE(OP_FABS, fabs(x))                                                                          \
    ONE(OP_SIGN, x < 0.0 ? -1.0 : x > 0.0 ? 1.0 : x)                                               \
    ONE(OP_COPYSIGN, copysign(x, y))                                                               \
    ONE(OP_FMIN, x <= y || y != y ? x : y)                                                         \
    ONE(OP_FMAX, x >= y || y != y ? x : y)                                                         \
    ONE(OP_FLOOR, floor(x))                                                                        \
    ONE(OP_CEIL, ceil(x))                                                                          \
    ONE(OP_FMOD, fmod(x, y))                                                                       \
    ONE(OP_REMAINDER, remainder(x, y))                                                             \
    ONE(OP_LT, x < y ? 1.0 : 0.0)                                                                  \
    ONE(OP_LE, x <= y ? 1.0 : 0.0)                                                                 \
    ONE(OP_EQ, x == y ? 1.0 : 0.0)                                                                 \
    ONE(OP_NE, x != y ? 1.0 : 0.0)                                                                 \
    ONE(OP_NOT, x == 0.0 ? 1.0 : 0.0)                                                              \
    ONE(OP_AND, x != 0.0 && y != 0.0 ? 1.0 : 0.0)                                                  \
    ONE(OP_OR, x != 0.0 || y != 0.0 ? 1.0 : 0.0)                                                   \
    ONE(OP_IF_ELSE_ZERO, x != 0.0 ? y : 0.0)                                                       \
    ONE(OP_MUL_ADD, x * y + w)                                                                     \
    ONE(OP_MUL_SUB, x * y - w)                                                                     \
    ONE(OP_SUB_MUL, w - x * y)                                                                     \
    ONE(OP_CELL, cell_of(tables, y, x))                                                            \
    ONE(OP_TURN, cell_of_turn(tables, w, x, y))                                                    \
    ONE(OP_PICK, number_of_cell(tables, y, w, x))

#ifdef __GNUC__
/* Each operation jumps to the next by itself: a processor foresees that better than the one jump of
   a switch. */
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wpedantic"
#define NEXT                                                                                       \
    if (code == end) return;                                                                       \
    goto *places[code->op];

static void carry_out(const zl_instruction *code, long long n, double *registers,
                      const double *const *tables) {
    static const void *const places[] = {
#define ONE(OP, FORMULA) [OP] = &&at_##OP,
        OPERATIONS(ONE)
#undef ONE
    };
    const zl_instruction *end = code + n;
    (void)tables;
    NEXT
#define ONE(OP, FORMULA)                                                                           \
    at_##OP : {                                                                                    \
        const double x = registers[code->a], y = registers[code->b], w = registers[code->c];       \
        (void)y;                                                                                   \
        (void)w;                                                                                   \
        registers[code->to] = FORMULA;                                                             \
        code++;                                                                                    \
        NEXT                                                                                       \
    }
    OPERATIONS(ONE)
#undef ONE
}
#undef NEXT
#pragma GCC diagnostic pop
#else
static void carry_out(const zl_instruction *code, long long n, double *registers,
                      const double *const *tables) {
    const zl_instruction *end = code + n;
    for (; code < end; code++) {
        const double x = registers[code->a], y = registers[code->b], w = registers[code->c];
        double z = 0.0;
        (void)y;
        (void)w;
        switch (code->op) {
#define ONE(OP, FORMULA)                                                                           \
    case OP:                                                                                       \
        z = FORMULA;                                                                               \
        break;
            OPERATIONS(ONE)
#undef ONE
        }
        registers[code->to] = z;
    }
}
#endif

/* The same for several states, a row of registers each entry of which belongs to one of them. */
static void carry_out_lanes(const zl_instruction *code, long long n, double *registers,
                            const double *const *tables) {
    const zl_instruction *end = code + n;
    for (; code < end; code++) {
        const double *first = registers + (long long)code->a * ZL_LANES;
        const double *second = registers + (long long)code->b * ZL_LANES;
        const double *third = registers + (long long)code->c * ZL_LANES;
        double *to = registers + (long long)code->to * ZL_LANES, found[ZL_LANES];
        int lane;
        (void)second;
        (void)third;
        switch (code->op) {
#define ONE(OP, FORMULA)                                                                           \
    case OP:                                                                                       \
        for (lane = 0; lane < ZL_LANES; lane++) {                                                  \
            const double x = first[lane], y = second[lane], w = third[lane];                       \
            (void)y;                                                                               \
            (void)w;                                                                               \
            found[lane] = FORMULA;                                                                 \
        }                                                                                          \
        break;
            OPERATIONS(ONE)
#undef ONE
        default:
            for (lane = 0; lane < ZL_LANES; lane++) found[lane] = 0.0;
        }
        for (lane = 0; lane < ZL_LANES; lane++) to[lane] = found[lane];
    }
}

/* Write parameters and constants, and do what depends on them alone. */
static void tape_prepare(const zl_tape *tape, double *registers, const double *p) {
    double *place = registers + tape->n_varying;
    memcpy(place, p, (size_t)tape->n_parameters * sizeof(double));
    place += tape->n_parameters;
    if (tape->n_constants) memcpy(place, tape->constants, (size_t)tape->n_constants * sizeof(double));
    carry_out(tape->code, tape->n_once, registers, tape->tables);
}

/* Do the rest. */
static void tape_run(const zl_tape *tape, double *registers, const double *varying,
                     double *outputs) {
    long long k;
    memcpy(registers, varying, (size_t)tape->n_varying * sizeof(double));
    carry_out(tape->code + tape->n_once, tape->n_instructions - tape->n_once, registers,
              tape->tables);
    for (k = 0; k < tape->n_outputs; k++) outputs[k] = registers[tape->outputs[k]];
}

/* Spread what depends on parameters alone over the lanes. */
static void tape_spread(const zl_tape *tape, const double *registers, double *lanes) {
    long long k;
    int lane;
    for (k = tape->n_varying; k < tape->n_registers; k++)
        for (lane = 0; lane < ZL_LANES; lane++) lanes[k * ZL_LANES + lane] = registers[k];
}

/* Do the rest for rows of varying entries and of outputs. */
static void tape_run_lanes(const zl_tape *tape, double *lanes, const double *varying,
                           double *outputs) {
    const size_t row = ZL_LANES * sizeof(double);
    long long k;
    memcpy(lanes, varying, (size_t)tape->n_varying * row);
    carry_out_lanes(tape->code + tape->n_once, tape->n_instructions - tape->n_once, lanes,
                    tape->tables);
    for (k = 0; k < tape->n_outputs; k++)
        memcpy(outputs + k * ZL_LANES, lanes + (long long)tape->outputs[k] * ZL_LANES, row);
}
