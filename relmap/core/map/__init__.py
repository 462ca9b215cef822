"""Where relative maps come together."""
