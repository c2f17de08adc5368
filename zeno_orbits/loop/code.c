/* The formulas of one machine as a library of their own, to which `zl_code` leads. */

#include <float.h>
#include <math.h>

#include "loop.h"
#include "lookup.c"
#include "formulas.c"
#include "check.c"

ZL_EXPORT zl_formula zl_one, zl_lanes;

int zl_one(const zl_problem *problem, int tape, const double *registers, const double *varying,
           double *outputs) {
    return compiled_formula(problem, tape, registers, varying, outputs);
}

int zl_lanes(const zl_problem *problem, int tape, const double *registers, const double *varying,
             double *outputs) {
    return compiled_lanes(problem, tape, registers, varying, outputs);
}
