"""What shows that lib/ can be trusted: one module for each kind of evidence, each a command and a make target."""
