/* Formulas as tapes. In a library that is compiled for one machine its formulas stand here. */

enum { KNOWN_STATES = 0 }; /* states of the machine, if the library serves no other */

/* Write what a formula of a view gives, nothing for one without outputs; 0 if the view is unknown. */
static int compiled_formula(long long view, int tape, const double *const *tables,
                            const double *registers, const double *varying, double *outputs) {
    (void)view, (void)tape, (void)tables, (void)registers, (void)varying, (void)outputs;
    return 0;
}

/* The same of the rate of a mode for rows of lanes. */
static int compiled_lanes(long long view, int tape, const double *const *tables,
                          const double *registers, const double *varying, double *outputs) {
    (void)view, (void)tape, (void)tables, (void)registers, (void)varying, (void)outputs;
    return 0;
}
