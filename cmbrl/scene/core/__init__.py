"""The arrays that the C++ core takes."""
