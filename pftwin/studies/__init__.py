"""Studies of scenes: what accuracy costs, what effects are worth, what is hard, what bears at given poses."""
