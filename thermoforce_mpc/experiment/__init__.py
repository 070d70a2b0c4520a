"""The composition root: experiments, where their models come from, and how they are run, resumed and explained."""
