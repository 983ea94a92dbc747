"""The answer: `Equations`, each an `Equation`, as text, numbers and files."""
