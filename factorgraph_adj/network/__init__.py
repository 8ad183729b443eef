"""What is measured and what is asked for: the network, its entities, and changes of both."""
