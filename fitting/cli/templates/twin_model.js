// The host side of `pftwin.simulate` in JavaScript; it calls programs that pftwin compiled to WebAssembly. It needs no
// page, so it runs in a worker and in Node. `facts` is from `programs` and fitting/cli/twin/facts.py.
function makeTwin(module, facts) {
    const { exports } = new WebAssembly.Instance(module, { Math });
    const slots = (address, size, real) => real ? new Float64Array(exports.memory.buffer, address, size)
        : new Int32Array(exports.memory.buffer, address, 2 * size);
    const write = ([address, size, real], values) => {
        const to = slots(address, size, real), from = typeof values === 'number' ? [values] : values;
        for (let k = 0; k < size; k++) { to[real ? k : 2 * k] = from[k]; }
    };
    const read = ([address, size, real]) => {
        const from = slots(address, size, real);
        return real ? from.slice() : Int32Array.from({ length: size }, (_, k) => from[2 * k]);
    };
    const all = (outputs) => {
        if (typeof outputs[0] === 'number') { return read(outputs); }
        const found = Array.isArray(outputs) ? [] : {};
        Object.keys(outputs).forEach((name) => { found[name] = all(outputs[name]); });
        return found;
    };
    const run = (name, inputs) => {
        const { inputs: places, outputs } = facts.programs[name];
        inputs.forEach((values, k) => write(places[k], values));
        exports[name]();
        return all(outputs);
    };
    const course = (m) => [m.center, m.quaternion, m.contact_force, m.medial, m.lateral];

    function settled(values) {
        const first = run('settle', [values, ...facts.start]);
        if (first.converged[0]) { return first; }
        const rest = run('relaxed', [values]);
        if (!rest.near[0]) { return first; }
        const second = run('settle', [values, rest.position, rest.quaternion]);
        return second.converged[0] ? second : first;
    }

    // As `accurate_enough` in pftwin.dynamics.tolerance: halves the step until the error is small; yields each motion.
    function* simulate(values) {
        const { rules } = facts, started = performance.now();
        const begin = settled(values);
        if (!begin.known[0]) { throw new Error('The start is too stiff for this page: use pftwin app.'); }
        const motion = (n) => {
            const began = performance.now(), found = run('motion', [values, ...begin.start, n]);
            const leapt = found.status.some((s) => s & facts.stepTooLong);
            return { ...found, substeps: n, sound: !leapt, ms: performance.now() - began };
        };
        let n = rules.substeps, coarse = motion(n / 2), here = motion(n);
        let error = run('estimate', [...course(here), ...course(coarse), ...Array(4).fill(new Float64Array(facts.frames)),
            rules.unconfirmed, +(here.sound && coarse.sound)]);
        for (let k = 0; k < rules.halvings && error.flags.some(Boolean); k++) {
            yield { ...here, finished: false, total: performance.now() - started };
            n *= 2;
            coarse = here;
            here = motion(n);
            error = run('estimate', [...course(here), ...course(coarse), ...error.halved, 1, +(here.sound && coarse.sound)]);
        }
        here.status = here.status.map((s, k) => s | error.flags[k]);
        yield { ...here, ...judged(here), finished: true, total: performance.now() - started };
    }

    // Repeats pftwin.results.verdict and pftwin.results.tracking.
    function judged(motion) {
        const n = facts.frames, reasons = [], remarks = [];
        facts.flags.forEach(({ bit, words, most, everywhere }) => {
            const count = motion.status.filter((s) => s & bit).length;
            if (count > most) { reasons.push(everywhere ? words : `${words} (${count} of ${n} frames)`); }
            if (count) { remarks.push(`${words}: ${count} of ${n} frames`); }
        });
        reasons.push(...facts.reasons);
        if (reasons.length) { return { verdict: `INVALID: ${reasons.join('; ')}`, tracking: '', events: null, remarks: [] }; }
        const events = facts.groove ? dislocations(motion) : null;
        const tracking = events === null ? 'not assessed: no contact surface'
            : events.map(describe).join('; ') || 'normal tracking';
        return { verdict: 'valid', tracking, events, remarks };
    }

    function offset(motion, k) {
        const { u, v } = facts.groove, at = motion.along[k];
        let i = 0;
        while (i < u.length - 1 && u[i + 1] <= at) { i++; }
        if (at <= u[0] || i === u.length - 1) { return motion.across[k] - v[at <= u[0] ? 0 : i]; }
        return motion.across[k] - (v[i] + (v[i + 1] - v[i]) * (at - u[i]) / (u[i + 1] - u[i]));
    }

    function dislocations(motion) {
        const events = [];
        let now = null;
        for (let k = 0; k < facts.frames; k++) {
            const y = offset(motion, k), far = Math.abs(y);
            if (now && far < facts.reEngaged * facts.dislocated) {
                now.back = facts.times[k];
                now = null;
            } else if (!now && far > facts.dislocated) {
                now = { time: facts.times[k], flexion: facts.flexion[k], side: y > 0 ? 'lateral' : 'medial', far: 0, back: null };
                events.push(now);
            }
            if (now && far > now.far) { now.far = far; }
        }
        return events;
    }

    const describe = (e) => `${e.side} dislocation at ${e.time.toFixed(2)} s at ${e.flexion.toFixed(1)} deg of knee flexion, `
        + `up to ${(1e3 * e.far).toFixed(1)} mm ${e.side} of the groove; ${e.back === null ? 'did not re-engage within the recording'
            : `re-engaged at ${e.back.toFixed(2)} s`}`;

    return { simulate };
}
if (typeof module !== 'undefined') { module.exports = { makeTwin }; }
