"""A parametric natural knee: attachments, motion, and a scene of a squat or a knee extension."""
