"""What an environment's arms go through in a control period, and what is recorded of a scene's."""
