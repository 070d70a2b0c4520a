"""Forecasts of the control-free temperature: methods, pretrained backbones, and the limit of weather corrections."""
