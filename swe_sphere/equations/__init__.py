"""What is solved: the effects, the scenes and the right-hand side."""
