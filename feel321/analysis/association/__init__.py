"""Does a metric go with what people feel? Correlations, their ceiling, and the classic tests beside them."""
