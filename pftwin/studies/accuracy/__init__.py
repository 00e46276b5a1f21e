"""The cost of accuracy in time: contact models, integrators, steps and float types measured side by side on a scene."""
