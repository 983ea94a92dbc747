"""The regression of one equation: from smoothed motion to a posterior."""
