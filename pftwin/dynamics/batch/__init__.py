"""Many scenes at once, over all devices: which devices, how members lie on them, and what comes back."""
