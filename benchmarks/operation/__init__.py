"""What records of ordinary operation tell: the effect of acting, and verified savings."""
