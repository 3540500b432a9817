"""The film around a load: membrane mechanics and quasi-static equilibrium, compiled with numba."""
