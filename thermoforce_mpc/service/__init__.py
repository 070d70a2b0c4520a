"""REST service with BOPTEST's protocol over the embedded plant, for clients of the BOPTEST service."""
