//! What other controls took for the same programs.

use std::collections::BTreeMap;

/// Machining times of one program.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Peer {
    pub(crate) trapezoid_s: f64,
    pub(crate) s_curve_s: f64,
}

/// By program name.
pub(crate) fn peers() -> Result<BTreeMap<String, Peer>, String> {
    let table: toml::Table = include_str!("../../data/linuxcnc.toml")
        .parse()
        .map_err(|error| format!("data/linuxcnc.toml: {error}"))?;
    let programs = table.get("program").and_then(toml::Value::as_array);
    let mut peers = BTreeMap::new();
    for program in programs.into_iter().flatten() {
        let seconds = |key: &str| program.get(key).and_then(toml::Value::as_float);
        let name = program.get("name").and_then(toml::Value::as_str);
        let (Some(name), Some(trapezoid_s), Some(s_curve_s)) =
            (name, seconds("trapezoid_s"), seconds("s_curve_s"))
        else {
            return Err(format!("data/linuxcnc.toml: {program} lacks a name or a time"));
        };
        peers.insert(
            name.to_owned(),
            Peer {
                trapezoid_s,
                s_curve_s,
            },
        );
    }
    Ok(peers)
}
