"""Methods that answer the questions, the client of model servers, and the simulated model."""
