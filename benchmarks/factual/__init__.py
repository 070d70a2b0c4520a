"""The paper's factual suite: few-shot forecasts of measured buildings. Read `homes`, `protocol`, `evaluate`."""
