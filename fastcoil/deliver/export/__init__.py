"""What is taken to a live loop: the controller as C, Structured Text and Python, with vectors that prove a port."""
