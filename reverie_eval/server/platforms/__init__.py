"""What leaves the server for elsewhere: its static copy, tables, Codabench and EvalAI."""
