"""What is compiled of evolution: imported only when it has to be compiled, see `native`."""
