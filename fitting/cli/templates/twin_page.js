// The page of a twin in a file: sliders, text and curves. Its worker simulates.
(async function () {
    const text = (id) => document.getElementById(id).textContent;
    const facts = JSON.parse(text('facts')), state = document.getElementById('state');
    const make = (tag, parent, words) => {
        const element = parent.appendChild(document.createElement(tag));
        if (words !== undefined) { element.textContent = words; }
        return element;
    };
    const tell = (tone, head, more) => {
        state.className = tone;
        state.replaceChildren();
        make('b', state, head);
        if (more) { make('div', state, more).className = 'small'; }
    };
    const sentence = (words) => `${words[0].toUpperCase()}${words.slice(1)}.`;

    const knobs = document.getElementById('knobs'), values = facts.knobs.map((k) => k.neutral), sliders = [];
    const groups = {};
    facts.knobs.forEach((knob, i) => {
        if (!groups[knob.group]) {
            groups[knob.group] = make('fieldset', knobs);
            make('legend', groups[knob.group], knob.group);
        }
        const label = make('label', groups[knob.group], knob.label), shown = make('output', label);
        const slider = make('input', label);
        Object.assign(slider, { type: 'range', name: knob.name, min: knob.least, max: knob.most, step: knob.step });
        label.title = knob.hint;
        sliders.push((value) => {
            slider.value = value;
            shown.textContent = String(value).replace('-', '\u2212');
        });
        sliders[i](knob.neutral);
        slider.addEventListener('input', () => {
            values[i] = slider.valueAsNumber;
            sliders[i](values[i]);
            ask();
        });
    });
    Object.entries(facts.missing).forEach(([group, why]) => { make('div', knobs, `${group}: cannot be changed: ${why}`).className = 'small'; });
    const reset = make('button', knobs, 'Reset');
    reset.type = 'button';
    reset.addEventListener('click', () => {
        facts.knobs.forEach((knob, i) => { values[i] = knob.neutral; sliders[i](knob.neutral); });
        ask();
    });

    const curves = [['Tilt [\u00B0], lateral positive', 'tilt', 180 / Math.PI], ['Shift [mm], lateral positive', 'shift', 1e3]];
    if (facts.hasContact) { curves.push(['Contact force [N]', 'force', 1]); }
    const canvases = curves.map(() => make('canvas', document.getElementById('curves')));
    let before = null, after = null;
    const numbers = (motion, name) => name === 'shift' ? motion.center.filter((_, k) => k % 3 === 1) : motion[name];
    function drawn(canvas, [title, name, scale]) {
        const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = 150;
        canvas.style.height = `${height}px`;
        Object.assign(canvas, { width: width * ratio, height: height * ratio });
        const pen = canvas.getContext('2d');
        pen.scale(ratio, ratio);
        pen.font = '12px system-ui, sans-serif';
        const series = [before, after].map((m) => m && Array.from(numbers(m, name), (x) => scale * x));
        const every = series.flatMap((s) => s || []).filter(Number.isFinite);
        if (!every.length) { return; }
        let low = every.reduce((a, b) => Math.min(a, b)), high = every.reduce((a, b) => Math.max(a, b));
        if (high - low < 1e-3) { low -= 1; high += 1; }
        const first = facts.times[0], last = facts.times[facts.frames - 1], left = 52, right = width - 8, top = 22, bottom = height - 20;
        const x = (t) => left + (right - left) * (t - first) / (last - first);
        const y = (v) => bottom - (bottom - top) * (v - low) / (high - low);
        pen.fillStyle = '#222';
        pen.fillText(title, left, 13);
        pen.fillStyle = '#555';
        pen.textAlign = 'right';
        const power = 10 ** Math.floor(Math.log10((high - low) / 5)); // ticks at 1, 2 or 5 times a power of ten
        const gap = [1, 2, 5, 10].map((k) => k * power).find((g) => g >= (high - low) / 5);
        const digits = Math.max(0, -Math.floor(Math.log10(gap)));
        for (let k = Math.ceil(low / gap); k <= high / gap; k += 1) {
            pen.fillText((k * gap).toFixed(digits).replace('-', '\u2212'), left - 6, y(k * gap) + 4);
            pen.fillRect(left, y(k * gap), right - left, 0.25);
        }
        pen.textAlign = 'center';
        [first, (first + last) / 2, last].forEach((t, k) => {
            pen.textAlign = ['left', 'center', 'right'][k];
            pen.fillText(t.toFixed(1), x(t), height - 5);
        });
        series.forEach((s, which) => {
            if (!s) { return; }
            pen.strokeStyle = COLOURS[which];
            pen.lineWidth = 1.5;
            pen.setLineDash(which && !after.finished ? [4, 3] : []);
            pen.beginPath();
            s.forEach((v, k) => { if (Number.isFinite(v)) { pen.lineTo(x(facts.times[k]), y(v)); } else { pen.moveTo(x(facts.times[k]), bottom); } });
            pen.stroke();
        });
    }
    const draw = () => canvases.forEach((canvas, k) => drawn(canvas, curves[k]));
    window.addEventListener('resize', draw);

    let asked = 0, worker = null;
    function ask(first) { worker.postMessage({ ...first, values: [...values], number: ++asked }); }
    function answered({ data }) {
        if (data.number !== asked) { return; }
        if (data.error) {
            tell('bad', `Not drawn: ${data.error}`);
            return;
        }
        after = data.motion;
        if (after.finished && !before && values.every((v, i) => v === facts.knobs[i].neutral)) { before = after; }
        draw();
        const span = facts.times[facts.frames - 1] - facts.times[0];
        const step = 1e3 * span / (facts.frames - 1) / after.substeps;
        document.getElementById('pace').textContent = `${span.toFixed(1)} s of motion, steps of ${step.toFixed(2)} ms: `
            + `${after.ms.toFixed(0)} ms, ${(span * 1e3 / after.ms).toFixed(0)} \u00D7 real time; with the start and the runs that estimate the error ${after.total.toFixed(0)} ms.`;
        if (!after.finished) { tell('', 'Checking with shorter steps ...', 'The verdict follows when this is done.'); }
        else if (after.verdict !== 'valid') { tell('bad', sentence(after.verdict), 'Do not interpret this motion.'); }
        else if (after.events === null) { tell('doubt', `Dislocation: ${after.tracking}`, after.remarks.join('; ')); }
        else { tell(after.events.length ? 'bad' : 'good', `Dislocation: ${after.events.length ? 'yes' : 'no'}`, [sentence(after.tracking), ...after.remarks.map((r) => sentence(r))].join(' ')); }
        window.twin = { after, before };
    }
    try {
        const packed = Uint8Array.from(atob(text('wasm')), (c) => c.charCodeAt(0));
        const whole = await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'))).arrayBuffer();
        worker = new Worker(URL.createObjectURL(new Blob([text('model')], { type: 'text/javascript' })));
        worker.onmessage = answered;
        worker.onerror = (event) => tell('bad', `Not drawn: ${event.message}`);
        ask({ module: await WebAssembly.compile(whole), facts });
    } catch (error) {
        tell('bad', `This browser cannot run the twin: ${error.message}`, 'It needs WebAssembly and DecompressionStream, which browsers have supported since 2023.');
    }
}());
