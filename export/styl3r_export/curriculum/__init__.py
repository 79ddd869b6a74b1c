"""Training: geometry from generated scenes, novel views, stylization (paper section 3.4)."""
