"""The experiments of the paper and around it, each with its table and plot."""
