"""How fast a network's graphs run beside the network itself in torch, and where the time goes."""
