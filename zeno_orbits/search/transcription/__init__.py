"""Write the conditions of a periodic orbit as a nonlinear program by collocation, and solve it.

Rows and unknowns have names, derivatives are exact and sparse, and Ipopt solves the program.

Offers: `transcribe` (a period and its numbers to a `ProgramBuilder` with the terms of an
objective), `solve` (a `NonlinearProgram` to a `Solution`), `TranscriptionSettings` and
`IpoptSettings`.

Imports: orbits, simulation, model, integrators, arrays, errors.
"""
