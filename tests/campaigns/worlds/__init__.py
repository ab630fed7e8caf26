"""Blind worlds: machines, instruments and effects that share no function with what makes the null simulations."""
