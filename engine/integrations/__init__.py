"""The benchmark in other frameworks. A module that needs a framework is imported only with its extra installed."""
