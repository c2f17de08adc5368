"""Find, verify and follow Zeno periodic orbits of electromechanical hybrid systems.

Import what you need from the modules, in the order of the theory: ``problem.load_problem``,
``compiled.compile_problem`` and ``bind``, ``simulate.simulate``, ``search.search_gains``,
``verify.verify``, ``plots``.
"""
