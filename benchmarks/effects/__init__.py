"""What a model from probing says of an action, beside what the action does to the same house."""
