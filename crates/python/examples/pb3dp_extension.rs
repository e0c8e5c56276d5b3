//! The module of Python as a library of the test build. It is not a program.

use pb3dp_python as _;
