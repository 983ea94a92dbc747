"""The answer of `discover`: `Equations`, an `Equation` for each coordinate, as text, numbers and files."""
