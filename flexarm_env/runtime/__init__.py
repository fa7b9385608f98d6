"""Control periods of an environment's arms, their derivatives, and recorded runs of a scene's arm."""
