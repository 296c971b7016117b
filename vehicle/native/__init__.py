"""The CTRV filter on packed tuples, in C++17 (built at installation where a compiler is found)."""
