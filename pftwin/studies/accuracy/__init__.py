"""What accuracy costs in time: contact models, integrators, steps and float types measured side by side on a scene."""
