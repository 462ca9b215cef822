"""Assigning observations anew, where the noise makes single matches ambiguous."""
