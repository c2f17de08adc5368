/* Formulas as tapes. In a library that is compiled for one problem its formulas stand here. */

enum { KNOWN_STATES = 0 }; /* states of the problem, if the library serves no other */

/* Write what a formula gives; nothing for one without outputs. */
static void compiled_formula(int tape, const double *registers, const double *varying,
                             double *outputs) {
    (void)tape, (void)registers, (void)varying, (void)outputs;
}

/* The same of the rate of a mode for rows of lanes. */
static void compiled_lanes(int tape, const double *registers, const double *varying,
                           double *outputs) {
    (void)tape, (void)registers, (void)varying, (void)outputs;
}
