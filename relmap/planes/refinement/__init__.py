"""The refined map: least squares over all observations, loops closed, walls joined."""
