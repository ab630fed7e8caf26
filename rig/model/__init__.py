"""What a rig is believed to be."""
