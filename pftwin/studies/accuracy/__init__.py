"""Work-precision study: errors and run times of contact models, integrators, steps and float types on a scene."""
