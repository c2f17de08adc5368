/* Formulas as code, if the problem has it. In code for one machine its formulas stand here. */

enum { KNOWN_STATES = 0 }; /* states of the machine, if the code serves no other */

static int compiled_formula(const zl_problem *problem, int tape, const double *registers,
                            const double *varying, double *outputs) {
    zl_formula *code = problem->code ? problem->code->one : 0;
    return code && code(problem, tape, registers, varying, outputs);
}

static int compiled_lanes(const zl_problem *problem, int tape, const double *registers,
                          const double *varying, double *outputs) {
    zl_formula *code = problem->code ? problem->code->lanes : 0;
    return code && code(problem, tape, registers, varying, outputs);
}
