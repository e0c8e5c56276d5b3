//! A control cycle does not touch the heap.
#![allow(clippy::unwrap_used)] // In helpers of tests.

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell as ThreadCell;

use common::{Cell, IDEAL, config, rotation};
use nalgebra::Vector3;

/// The system's allocator, counting the calls of each thread.
struct Counting;

thread_local! {
    static CALLS: ThreadCell<usize> = const { ThreadCell::new(0) };
}

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        CALLS.with(|calls| calls.set(calls.get() + 1));
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: `pointer` came from `System.alloc` with this layout.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn steps_do_not_allocate() {
    let mut cell = Cell::new(config(), IDEAL, 0.0);
    let target = cell.target_for_hand_moved(Vector3::new(0.05, -0.04, 0.03), rotation(0.1, 0.2, -0.1));
    let mut calls = 0;
    for _ in 0..1000 {
        let seen = cell.observe(&target);
        let before = CALLS.with(ThreadCell::get);
        let step = cell.controller.step(&cell.joints, Some(&seen), cell.now());
        calls += CALLS.with(ThreadCell::get) - before;
        assert!(step.position_error_m.is_some());
        cell.step_controller();
    }
    assert_eq!(calls, 0);
    let probe = CALLS.with(ThreadCell::get);
    drop(std::hint::black_box(Box::new([0u8; 64])));
    assert!(CALLS.with(ThreadCell::get) > probe, "the counter counts");
}
