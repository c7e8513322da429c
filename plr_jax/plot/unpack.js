const packed = Uint8Array.from(atob("{{data}}"), letter => letter.charCodeAt(0));
new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"))).text().then(text => {
    const script = document.createElement("script");
    script.textContent = text;
    document.body.append(script);
});
