"""Implicit solvers, as diffrax solvers, that take their linear algebra from the structure of the problem."""
