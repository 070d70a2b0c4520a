"""Plain forecasters of the free response that the frozen one is compared with."""
