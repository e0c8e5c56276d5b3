//! The pb3dp program: configuration, wiring, commands.
