// Runs in the page's worker: simulates for the latest values received, and abandons earlier ones.
if (typeof self !== 'undefined' && typeof window === 'undefined') {
    let twin = null, wanted = 0;
    self.onmessage = async ({ data }) => {
        if (data.module) { twin = makeTwin(data.module, data.facts); }
        const mine = data.number;
        wanted = mine;
        try {
            for (const motion of twin.simulate(data.values)) {
                self.postMessage({ number: mine, motion });
                await new Promise((done) => { setTimeout(done); }); // lets newer values arrive
                if (wanted !== mine) { return; }
            }
        } catch (error) {
            self.postMessage({ number: mine, error: error.message });
        }
    };
}
