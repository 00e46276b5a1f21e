"""A parametric natural knee: anatomy by name, closed surfaces made from it, and a scene that squats or extends."""
