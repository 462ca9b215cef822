"""What is known: landmarks, observations, and who is due."""
