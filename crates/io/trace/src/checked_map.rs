//! Metadata with their own checksum: the format protects chunks and attachments, but not metadata, and a
//! flipped bit in a period or an axis letter gives wrong figures.

use std::collections::BTreeMap;

use mcap::records::Metadata;

use crate::summary::content;

const KEY: &str = "crc32";

fn checksum(map: &BTreeMap<String, String>) -> String {
    let bytes = content(&Metadata {
        name: String::new(),
        metadata: map.clone(),
    });
    // Without the length of the name: the map as in the format.
    format!("{:08x}", crc32fast::hash(&bytes[4..]))
}

/// Adds the checksum.
pub(crate) fn with_checksum(mut map: BTreeMap<String, String>) -> BTreeMap<String, String> {
    map.remove(KEY);
    let sum = checksum(&map);
    map.insert(KEY.to_owned(), sum);
    map
}

/// Removes the checksum; `None` if it is missing or wrong.
pub(crate) fn without_checksum(mut map: BTreeMap<String, String>) -> Option<BTreeMap<String, String>> {
    let found = map.remove(KEY)?;
    (found == checksum(&map)).then_some(map)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_changed_value_or_key_is_noticed() {
        let map = BTreeMap::from([("period_ns".to_owned(), "1000000".to_owned())]);
        let sealed = with_checksum(map.clone());
        assert_eq!(without_checksum(sealed.clone()), Some(map.clone()));
        let mut changed = sealed;
        changed.insert("period_ns".to_owned(), "1000001".to_owned());
        assert_eq!(without_checksum(changed), None);
        assert_eq!(without_checksum(map), None);
    }
}
