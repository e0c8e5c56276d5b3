//! Ranges of values of images with more than 8 bits, as text.

use pb3dp_geometry::ValueRange;

#[test]
fn wrong_ranges_are_refused() {
    for text in ["", "5", "5,5", "9,3", "-1,5", "0,70000", "a,b"] {
        let message = text.parse::<ValueRange>().unwrap_err().to_string();
        assert!(message.contains(&format!("{text:?}")) && message.contains("0,4095"), "{message}");
    }
    assert_eq!("100, 610".parse::<ValueRange>().unwrap().to_string(), "100,610");
}
