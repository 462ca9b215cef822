"""Links between scans: the motion that walls imply and beams confirm, or a break."""
