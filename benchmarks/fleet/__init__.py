"""Many buildings: what it costs to identify, to plan for, to coordinate and to simulate them."""
