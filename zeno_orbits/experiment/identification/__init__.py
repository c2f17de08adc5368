"""Parameters of a machine from a recording, by least squares over closed orbits, with intervals."""
