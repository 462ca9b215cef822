"""State of the engine: landmarks, observations, schedule."""
