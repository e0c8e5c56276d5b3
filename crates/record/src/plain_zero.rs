//! Display of numbers without negative zero.

/// Replaces `-0.00`, the result of rounding, by `0.00` in a text; the length stays the same.
pub fn plain_zero(text: &str) -> String {
    let bytes = text.as_bytes();
    let is_part = |at: usize| bytes.get(at).is_some_and(|byte| byte.is_ascii_alphanumeric() || *byte == b'.');
    let mut plain = bytes.to_vec();
    for (at, _) in text.match_indices("-0") {
        let number = text[at + 1..].bytes().take_while(|byte| byte.is_ascii_digit() || *byte == b'.');
        let length = number.clone().count();
        let is_zero = number.clone().all(|byte| matches!(byte, b'0' | b'.'));
        if is_zero && !is_part(at + 1 + length) && (at == 0 || !is_part(at - 1)) {
            plain[at] = b' ';
        }
    }
    // Only ASCII was replaced by ASCII.
    String::from_utf8(plain).unwrap_or_else(|_| text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_zeros_lose_their_sign() {
        for (text, plain) in [
            ("-0.00", " 0.00"),
            ("x  -0.000  -0.001 -0", "x   0.000  -0.001  0"),
            ("2026-01-0, a-0.0, 1e-0, -0.0e3, -0.0 mm", "2026-01-0, a-0.0, 1e-0, -0.0e3,  0.0 mm"),
            ("+0.000 -12.0 é -0.0", "+0.000 -12.0 é  0.0"),
        ] {
            assert_eq!(plain_zero(text), plain);
        }
    }
}
