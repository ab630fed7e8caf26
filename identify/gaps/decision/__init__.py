"""What a record says of the hypotheses that another record suggested, and what that makes of the gap."""
