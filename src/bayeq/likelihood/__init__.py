"""One likelihood of the record: states follow the equation, what it leaves is a process of its own."""
