"""Small matrices, block-sparse factorisation, order statistics."""
