"""The kinematic smoother: every measured channel of a chain fused, all derivatives from one motion."""
