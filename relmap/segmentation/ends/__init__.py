"""Where walls end, and why."""
