"""The search for straight pieces in C++17 (built at installation where a compiler is found)."""
